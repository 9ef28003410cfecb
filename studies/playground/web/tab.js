// The source of frames in the tab itself: the emitted plant under exported laws.  Same words as the one in Python.
import { CATALOGUE } from "./catalogue.js";
import { LAWS } from "./laws.js";
import { changedRig, Stepper } from "./physics.js";

/** How a run ends, by its code; the order is that of dpend.Status. */
export const ENDS = [
    "",
    "The cart reached the end of the track.",
    "Link 1 fell: it leans by more than a quarter turn.",
    "Link 2 fell: it leans by more than a quarter turn.",
    "The state is no longer a finite number.",
    "The controller failed.",
];

/** Return the code of how a state ends a run, zero if it does not. */
export function endOf(x, task, rig) {
    for (let i = 0; i < 6; i++) if (!Number.isFinite(x[i])) return 4;
    if (!(Math.abs(x[0]) <= (rig.track_limit ?? Infinity))) return 1;
    if (task !== "balance") return 0;
    return Math.abs(x[1]) > Math.PI / 2 ? 2 : Math.abs(x[2]) > Math.PI / 2 ? 3 : 0;
}

class Copies {
    constructor(law, rig, message, states, kept) {
        Object.assign(this, { law, rig, task: message.task, n: states.length / 6 });
        this.shown = Float64Array.from(states);
        this.steppers = [];
        this.memories = kept?.n === this.n ? kept.memories : Array.from({ length: this.n }, () => law.reset());
        this.y = [];
        this.codes = [];
        for (let i = 0; i < this.n; i++) {
            const x = this.shown.subarray(6 * i, 6 * i + 6);
            this.steppers.push(new Stepper(rig, 1009 * i + message.seed + message.k));
            this.codes.push(endOf(x, this.task, rig));
            this.y.push(this.steppers[i].reset(x));
        }
    }

    advance(samples, push) {
        const x = [],
            u = [];
        for (let k = 0; k < samples; k++) {
            const running = !this.codes[0];
            for (let i = 0; i < this.n; i++) if (!this.codes[i]) this.move(i, push);
            if (running) u.push(this.steppers[0].force);
            if (running && this.n === 1) x.push(Array.from(this.shown));
        }
        return { ...this.frame(), x, u, ms: null };
    }

    move(i, push) {
        this.y[i] = this.steppers[i].step(this.law.act(this.memories[i], this.y[i]), push);
        const { x } = this.steppers[i];
        this.codes[i] = endOf(x, this.task, this.rig);
        if (this.codes[i] !== 4) this.shown.set(x, 6 * i);
    }

    frame() {
        return { states: this.shown, codes: this.codes, failed: "" };
    }
}

export class TabSource {
    lead = 0;

    constructor() {
        this.lanes = [];
    }

    /** Begin a scene, or go on with one that was changed. */
    async scene(message) {
        const before = this.message,
            rig = changedRig(CATALOGUE.rigs[message.rig], message.changes);
        const same = message.k > 0 && before && before.rig === message.rig;
        this.lanes = message.controllers.map((name, i) => {
            const law = LAWS[message.rig][name];
            const kept = same && before.controllers[i] === name ? this.lanes[i] : null;
            return new Copies(law, rig, message, message.states[i], kept);
        });
        this.message = message;
        return { lanes: this.lanes.map((lane) => lane.frame()) };
    }

    /** Move on by some samples under a push. */
    async advance(n, push) {
        return { lanes: this.lanes.map((lane) => lane.advance(n, push)) };
    }

    close() {}
}

/** Return whether a controller can work in the tab. */
export function worksInTab(name, rig) {
    return name in LAWS[rig];
}
