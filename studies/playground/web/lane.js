// What one lane has shown since its run began, and the figures of its force, as dpend.metrics defines them.
import { energies } from "./plant.js";
import { coefficients } from "./physics.js";

const MOST_SAMPLES = 60000; // 20 minutes at 50 a second; a recording ends there
const KEPT = 8; // samples between which pictures are drawn
const UPRIGHT = 0.2; // rad, as dpend.SwingUp has it

/** Return an angle less its whole turns. */
export const wrapped = (angle) => angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));

export class LaneRecord {
    constructor(look, states, rig) {
        Object.assign(this, {
            look,
            t: [0],
            x: [Array.from(states.subarray(0, 6))],
            u: [],
            pushes: [],
            share: [1],
        });
        this.energy = [];
        this.jumps = this.switches = this.saturated = this.effort = this.upSince = 0;
        this.lastSign = this.k = 0;
        this.past = [];
        this.ms = null;
        this.use(rig);
        this.energy.push(this.energyOf(this.x[0]));
        this.take(states, [], "");
    }

    get name() {
        return this.look.name;
    }

    get single() {
        return this.states.length === 6;
    }

    /** Go on with a rig that was changed. */
    use(rig) {
        this.rig = rig;
        this.c = coefficients(rig);
        const up = new Float64Array(6);
        this.upright = this.energyOf(up);
    }

    energyOf(x) {
        const [kinetic, potential] = energies(x, this.c);
        return kinetic + potential;
    }

    take(states, codes, failed) {
        this.states = Float64Array.from(states);
        this.past = [...this.past.filter(({ k }) => k < this.k).slice(-KEPT), { k: this.k, states: this.states }];
        this.codes = Array.from(codes);
        this.failed = failed;
    }

    /** Take what a source says of n samples under a push. */
    extend(said, n, push) {
        const h = this.rig.sample_time,
            limit = this.rig.force_limit ?? Infinity,
            scale = this.rig.force_limit ?? 1;
        const standing = said.codes.filter((code) => !code).length / said.codes.length;
        this.k += n;
        if (!this.single) for (let k = 0; k < n; k++) this.share.push(standing);
        for (let k = 0; k < said.u.length && this.u.length < MOST_SAMPLES; k++) {
            const now = this.single ? said.x[k] : Array.from(said.states.slice(0, 6));
            const u = said.u[k],
                last = this.u.length ? this.u[this.u.length - 1] : u;
            this.jumps += Math.abs(u - last) / scale;
            if (u !== 0) {
                if (Math.sign(u) === -this.lastSign) this.switches += 1;
                this.lastSign = Math.sign(u);
            }
            if (Math.abs(u) >= limit * (1 - 1e-12) - 3 * this.rig.force_noise) this.saturated += 1;
            this.effort += u * u * h;
            this.u.push(u);
            this.pushes.push(push);
            this.t.push(this.u.length * h);
            this.x.push(now);
            this.energy.push(this.energyOf(now));
            const up = [1, 2].every((i) => Math.abs(wrapped(now[i])) <= UPRIGHT);
            if (!up) this.upSince = this.u.length * h;
        }
        this.ms = said.ms;
        this.take(said.states, said.codes, said.failed);
    }

    /** Return where the copies stood at a time, between two samples. */
    at(time) {
        const at = time / this.rig.sample_time,
            later = this.past.find(({ k }) => k >= at) ?? this.past[this.past.length - 1];
        const before = this.past[this.past.indexOf(later) - 1] ?? later;
        const part = later.k > before.k ? Math.max(0, (later.k - at) / (later.k - before.k)) : 0;
        return part > 0
            ? later.states.map((last, i) => last - Math.min(part, 1) * (last - before.states[i]))
            : later.states;
    }

    get ended() {
        return this.codes.length > 0 && this.codes.every((code) => code !== 0);
    }

    get seconds() {
        return this.u.length * this.rig.sample_time;
    }

    get standing() {
        return this.codes.length ? this.codes.filter((code) => !code).length / this.codes.length : 1;
    }

    /** Return the figures of the run so far; per second where that is said. */
    figures() {
        const { seconds } = this,
            per = seconds > 0 ? 1 / seconds : 0;
        return {
            seconds,
            standing: this.standing,
            variation: this.jumps * per,
            switches: this.switches * per,
            saturated: this.saturated * this.rig.sample_time * per,
            effort: this.effort,
            up: Math.max(0, seconds - this.upSince),
            ms: this.ms,
        };
    }
}
