// Replays of recorded runs, on the playground's stage and plots.
import { REPLAYS } from "./replays.js";
import { LaneRecord } from "./lane.js";
import { drawPlots } from "./plots.js";
import { Stage } from "./stage.js";

const RATES = { "real time": 1, half: 0.5, "a quarter": 0.25, "a tenth": 0.1 };
const byId = (id) => document.getElementById(id);

function fill(list, names, chosen) {
    list.replaceChildren(...names.map((name) => new Option(name, name, false, name === chosen)));
}

class Replay {
    constructor() {
        this.stage = new Stage(byId("stage"));
        this.running = false;
        fill(
            byId("scene"),
            REPLAYS.map((each) => each.title),
            REPLAYS[0].title,
        );
        fill(byId("speed"), Object.keys(RATES), "real time");
        byId("scene").addEventListener("change", () => this.enter());
        for (const side of ["left", "right"]) byId(side).addEventListener("change", () => this.choose());
        byId("play").addEventListener("click", () => this.play(!this.running));
        byId("time").addEventListener("input", () => {
            this.play(false);
            this.goTo(Number(byId("time").value));
        });
        new ResizeObserver(() => this.draw()).observe(byId("stage").parentElement);
        matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
        this.enter();
    }

    enter() {
        this.shown = REPLAYS.find((each) => each.title === byId("scene").value);
        const names = this.shown.runs.map((run) => run.look.name);
        fill(byId("left"), names, names[0]);
        fill(byId("right"), [...names, "–"], names[1] ?? "–");
        this.choose();
    }

    choose() {
        const names = [byId("left").value, byId("right").value];
        this.runs = names.map((name) => this.shown.runs.find((run) => run.look.name === name)).filter(Boolean);
        this.h = this.shown.rig.sample_time;
        this.length = this.h * Math.max(...this.runs.map((run) => run.u.length));
        byId("time").max = this.length;
        this.play(false);
        this.goTo(this.length / 2);
    }

    play(running) {
        if (running && this.clock >= this.length) this.goTo(0);
        this.running = running;
        byId("play").textContent = running ? "Pause" : "Play";
        this.last = null;
        if (running) requestAnimationFrame((now) => this.tick(now));
    }

    tick(now) {
        if (!this.running) return;
        const passed = this.last === null ? 0 : Math.min((now - this.last) / 1000, 0.1) * RATES[byId("speed").value];
        this.last = now;
        this.goTo(Math.min(this.clock + passed, this.length));
        if (this.clock >= this.length) this.play(false);
        else requestAnimationFrame((next) => this.tick(next));
    }

    goTo(time) {
        const back = !(time >= this.clock) || this.lanes?.some((lane, i) => lane.run !== this.runs[i]);
        if (back || this.lanes?.length !== this.runs.length) {
            this.lanes = this.runs.map((run) => {
                const lane = new LaneRecord(run.look, Float64Array.from(run.x[0]), this.shown.rig);
                return Object.assign(lane, { run });
            });
        }
        this.clock = time;
        for (const lane of this.lanes) {
            const { x, u, code } = lane.run,
                until = Math.min(Math.ceil(time / this.h - 1e-9), u.length);
            for (let k = lane.u.length; k < until; k++) {
                const codes = [k + 1 === u.length ? code : 0],
                    states = Float64Array.from(x[k + 1]);
                lane.extend({ x: [x[k + 1]], u: [u[k]], states, codes, failed: "", ms: null }, 1, null);
            }
        }
        this.draw();
    }

    draw() {
        const scene = { task: this.shown.task, copies: 1, rig: "", changes: {} };
        this.stage.draw({ scene, lanes: this.lanes, time: this.clock, drag: null });
        drawPlots(byId("plots"), this.lanes, this.clock);
        byId("time").value = this.clock;
        byId("clock").textContent = `${this.clock.toFixed(1)} of ${this.length.toFixed(1)} s`;
    }
}

new Replay();
