// The sampled loop around the plant, as dpend.Stepper has it: the plant itself is emitted from the equations.
import { lumped, rates, sample } from "./plant.js";

const MOST_SUBSTEPS = 1000;

/** A generator of numbers that a seed and a stream decide: mulberry32, and normal numbers from two of its own. */
export class Noise {
    constructor(seed, stream) {
        this.state = (Math.imul(seed + 1, 0x9e3779b1) ^ Math.imul(stream + 1, 0x85ebca6b)) >>> 0;
        for (let i = 0; i < 4; i++) this.uniform();
    }

    uniform() {
        this.state = (this.state + 0x6d2b79f5) >>> 0;
        let z = Math.imul(this.state ^ (this.state >>> 15), this.state | 1);
        z ^= z + Math.imul(z ^ (z >>> 7), z | 61);
        return ((z ^ (z >>> 14)) >>> 0) / 4294967296;
    }

    normal() {
        return Math.sqrt(-2 * Math.log(1 - this.uniform())) * Math.cos(2 * Math.PI * this.uniform());
    }
}

/** Return a rig as the catalogue has it, changed: null is no limit, and a centre or inertia left out. */
export function changedRig(rig, changes) {
    const own = {},
        plant = {};
    for (const [name, value] of Object.entries(changes)) (name in rig.params ? plant : own)[name] = value;
    return { ...rig, ...own, params: { ...rig.params, ...plant } };
}

/** Return the lumped coefficients of a rig: a centre left out is the middle, an inertia the uniform rod's. */
export function coefficients(rig) {
    const p = { ...rig.params };
    for (const k of [1, 2]) {
        p[`com${k}`] ??= p[`length${k}`] / 2;
        p[`inertia${k}`] ??= (p[`mass${k}`] * p[`length${k}`] ** 2) / 12;
    }
    return lumped(p);
}

/** Return how many Runge-Kutta steps a sample takes, as dpend.Rig has it, so that stiff friction comes to rest. */
export function stableSubsteps(rig, c) {
    if (!(c.b0 || c.b1 || c.b2 || c.coulomb)) return rig.substeps;
    const speed = 1e-7,
        x = new Float64Array(6),
        plus = new Float64Array(6),
        minus = new Float64Array(6);
    let fastest = 0;
    for (let i = 0; i < 5; i++) {
        for (let j = 0; j < 8; j++) {
            let trace = 0;
            for (let k = 3; k < 6; k++) {
                x.fill(0);
                x[1] = (Math.PI / 4) * i;
                x[2] = (Math.PI / 4) * j;
                x[k] = speed;
                rates(x, [0, 0, 0], c, plus);
                x[k] = -speed;
                rates(x, [0, 0, 0], c, minus);
                trace -= (plus[k] - minus[k]) / (2 * speed);
            }
            fastest = Math.max(fastest, trace);
        }
    }
    return Math.min(Math.max(rig.substeps, Math.ceil((fastest * rig.sample_time) / 2 - 1e-6)), MOST_SUBSTEPS);
}

/** Values that come out so many samples after they went in. */
class DelayLine {
    constructor(delay, first) {
        this.slots = Array.from({ length: delay + 1 }, () => first);
    }

    pass(value) {
        this.slots.push(value);
        this.slots.shift();
        return this.slots[0];
    }
}

/** One copy of a rig, moved a sample at a time: measured, delayed, limited, lagged, disturbed, moved. */
export class Stepper {
    constructor(rig, seed) {
        this.rig = rig;
        this.c = coefficients(rig);
        this.substeps = stableSubsteps(rig, this.c);
        this.sensors = new Noise(seed, 0);
        this.actuator = new Noise(seed, 1);
        this.remainder = rig.actuator_lag > 0 ? Math.exp(-rig.sample_time / rig.actuator_lag) : 0;
        this.x = new Float64Array(6);
        this.f = new Float64Array(3);
        this.force = 0;
    }

    /** Set the state with actuator and sensors at rest, and return what is measured. */
    reset(x) {
        this.x.set(x);
        this.drive = this.force = 0;
        this.commands = new DelayLine(this.rig.actuator_delay, 0);
        const reading = this.measured();
        this.readings = new DelayLine(this.rig.sensor_delay, reading);
        return reading;
    }

    /** Move on by one sample under a command and a push, and return what is measured then. */
    step(command, push) {
        const { rig } = this,
            limit = rig.force_limit ?? Infinity;
        let u = Math.max(-limit, Math.min(limit, this.commands.pass(command)));
        u += this.remainder * (this.drive - u);
        this.drive = u;
        if (rig.force_noise > 0) u += rig.force_noise * this.actuator.normal();
        this.force = u;
        this.f[0] = u + push[0];
        this.f[1] = push[1];
        this.f[2] = push[2];
        sample(this.x, this.f, this.c, rig.sample_time / this.substeps, this.substeps, this.x);
        return this.readings.pass(this.measured());
    }

    measured() {
        const y = Float64Array.from(this.x),
            std = this.rig.sensor_noise;
        if (std > 0) for (let i = 0; i < 6; i++) y[i] += std * this.sensors.normal();
        return y;
    }
}
