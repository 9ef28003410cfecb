// The page's loop: it asks a source for samples as time goes by, and draws between the last two.
import { CATALOGUE } from "./catalogue.js";
import { Controls, find, showFigures } from "./controls.js";
import { Hands } from "./hands.js";
import { LaneRecord } from "./lane.js";
import { changedRig } from "./physics.js";
import { drawPlots } from "./plots.js";
import { copyAddress, Recorder, saveTable } from "./record.js";
import { fitted, hashOf, sceneOf, STARTS, startStates } from "./scene.js";
import { PythonSource } from "./socket.js";
import { Stage, wordsOf } from "./stage.js";
import { TabSource } from "./tab.js";

const SPEEDS = [
    [1, "real time"],
    [0.5, "half"],
    [0.25, "a quarter"],
    [0.1, "a tenth"],
    [0.05, "a twentieth"],
];
const GETTING_READY =
    "Getting ready. The first time a planner is used it is compiled, which takes up to half a minute.";
const MOST_BEHIND = 8; // samples asked for at once, after which time is let go

class Page {
    constructor() {
        this.scene = sceneOf(location.hash);
        this.stage = new Stage(find("stage"));
        this.running = !matchMedia("(prefers-reduced-motion: reduce)").matches;
        this.lanes = [];
        this.k = 0; // samples that the curves show
        this.earlier = 0; // and those before, which only the source counts
        this.clock = 0; // s, what is shown
        this.asking = false;
        this.frames = this.ticks = 0;
        this.controls = new Controls(find("controls"), find("plant"), this.scene, (name, value) =>
            this.choose(name, value),
        );
        this.bar();
        this.hands = new Hands(this, find("stage"));
        this.recorder = new Recorder(find("stage"), (why) => this.notice(why));
        this.connect();
        addEventListener("hashchange", () => {
            if (location.hash === hashOf(this.scene)) return;
            const { source } = this.scene;
            this.scene = sceneOf(location.hash);
            if (this.scene.source !== source) this.connect();
            else this.begin();
        });
        requestAnimationFrame((now) => this.loop(now));
    }

    // ------------------------------------------------------------------------------------------------ scene and source

    connect() {
        this.source?.close();
        this.source =
            this.scene.source === "tab"
                ? new TabSource()
                : new PythonSource(
                      (why) => this.notice(why),
                      () => this.resume(),
                  );
        this.begin();
    }

    /** Begin the scene anew. */
    begin() {
        const states = startStates(this.scene),
            rig = this.rig;
        this.k = this.clock = this.earlier = 0;
        this.lanes = looksOf(this.names).map((look) => new LaneRecord(look, states, rig));
        this.describe();
    }

    get names() {
        return this.scene.right ? [this.scene.left, this.scene.right] : [this.scene.left];
    }

    get rig() {
        return changedRig(CATALOGUE.rigs[this.scene.rig], this.scene.changes);
    }

    /** Send the source the scene as it is now, states and all; of several while one is under way the last one counts. */
    async describe() {
        history.replaceState(null, "", hashOf(this.scene));
        this.controls.show(this.scene);
        this.stale = true;
        if (this.describing) return;
        this.describing = true;
        try {
            while (this.stale) {
                while (this.asking) await new Promise((resolve) => setTimeout(resolve, 1));
                this.stale = false;
                const { source, lanes } = this;
                try {
                    const { rig, task, changes, seed } = this.scene;
                    const message = {
                        rig,
                        task,
                        changes,
                        controllers: lanes.map((lane) => lane.name),
                        seed,
                        k: this.earlier + this.k,
                        states: lanes.map((lane) => lane.states),
                    };
                    const said = await this.patiently(source.scene(structuredClone(message)));
                    if (source !== this.source || lanes !== this.lanes) {
                        this.stale = true;
                        continue;
                    }
                    lanes.forEach((lane, i) =>
                        lane.take(said.lanes[i].states, said.lanes[i].codes, said.lanes[i].failed),
                    );
                    this.ready = true;
                    this.notice("");
                } catch (error) {
                    this.ready = false;
                    if (source !== this.source) this.stale = true;
                    else if (error.gone) await new Promise((resolve) => setTimeout(resolve, 50));
                    else this.notice(error.message);
                }
            }
        } finally {
            this.describing = false;
        }
    }

    /** Return what a source answers, and say why it takes long, if it does. */
    async patiently(answer) {
        const waiting = setTimeout(() => this.notice(GETTING_READY), 1500);
        try {
            return await answer;
        } finally {
            clearTimeout(waiting);
            if (find("notice").textContent === GETTING_READY) this.notice("");
        }
    }

    /** Go on after a lost connection from where the pendulums stand. */
    resume() {
        this.notice("");
        this.describe();
    }

    /** Ask the source for the samples that are due. */
    async advance() {
        const h = this.rig.sample_time,
            lead = this.running ? this.source.lead : 0;
        const due = Math.ceil(this.clock / h - this.k + lead - 1e-9);
        if (due < 1 || this.asking || this.describing || !this.ready) return;
        this.asking = true;
        const { source, lanes } = this,
            n = Math.min(due, MOST_BEHIND),
            push = this.hands.pushFor(n);
        try {
            const said = await this.patiently(source.advance(n, push));
            if (source !== this.source || lanes !== this.lanes) return;
            this.k += n;
            lanes.forEach((lane, i) => lane.extend(said.lanes[i], n, push));
        } catch (error) {
            this.ready = false;
            if (!error.gone) this.failed(error);
        } finally {
            this.asking = false;
        }
    }

    failed(error) {
        this.notice(`${error.message} Choose another controller, or start again.`);
        this.pause();
    }

    // ------------------------------------------------------------------------------------------------------------ loop

    loop(now) {
        const seconds = Math.min((now - (this.before ?? now)) / 1000, 0.1),
            h = this.rig.sample_time;
        this.before = now;
        if (this.running && this.ready) this.clock += seconds * this.scene.speed;
        const last = this.k * h;
        this.advance();
        this.clock = Math.min(this.clock, last + h); // what a slow source does not deliver is let go
        const shown = Math.min(this.clock, last);
        const moved = shown !== this.lastShown || Boolean(this.hands.drag);
        if (moved) this.frames += 1;
        this.measure(now);
        this.ticks += 1;
        if (moved || this.ticks % 10 === 0) this.draw(shown, !moved || this.ticks % 4 === 0);
        this.lastShown = shown;
        requestAnimationFrame((next) => this.loop(next));
    }

    /** Draw the stage at a time, and all that need not move with it. */
    draw(shown, all) {
        const { scene, lanes } = this,
            { drag } = this.hands;
        this.stage.draw({ scene, lanes, time: shown, drag: drag?.to && this.running ? drag : null });
        if (this.recorder.take()) this.choose("gif");
        if (all) {
            if (scene.copies === 1) drawPlots(find("plots"), lanes, shown);
            find("plots").hidden = scene.copies > 1;
            showFigures(find("figures"), lanes);
        }
        const words = lanes
            .map((lane) => `${lane.name}: ${lane.failed || (lane.codes[0] ? wordsOf(lane, scene) : "running")}`)
            .join(" ");
        if (scene.copies === 1 && find("status").textContent !== words) find("status").textContent = words;
        find("stage").setAttribute("aria-label", lanes.map((lane) => lane.name).join(" beside "));
    }

    /** Show how many pictures a second are new, and how fast time goes by. */
    measure(now) {
        const from = (this.since ??= { now, frames: this.frames, k: this.k });
        if (now - from.now < 1000) return;
        const per = 1000 / (now - from.now);
        this.fps = (this.frames - from.frames) * per;
        const pace = Math.max(0, this.k - from.k) * this.rig.sample_time * per;
        find("rate").textContent = this.running
            ? `${this.fps.toFixed(0)} pictures/s, ${pace.toFixed(2)} × real time`
            : "";
        this.since = { now, frames: this.frames, k: this.k };
    }

    notice(text) {
        find("notice").textContent = text ?? "";
        find("notice").hidden = !text;
    }

    // -------------------------------------------------------------------------------------------------------- controls

    bar() {
        find("speed").append(...SPEEDS.map(([value, label]) => new Option(label, value)));
        if (!SPEEDS.some(([value]) => value === this.scene.speed))
            find("speed").append(new Option(`× ${this.scene.speed}`, this.scene.speed));
        find("speed").value = this.scene.speed;
        find("speed").addEventListener("change", (event) => this.choose("speed", Number(event.target.value)));
        find("play").addEventListener("click", () => this.turn());
        find("step").addEventListener("click", () => this.single());
        find("restart").addEventListener("click", () => this.begin());
        this.labels();
    }

    labels() {
        find("play").textContent = this.running ? "Pause" : "Go on";
    }

    /** Go on, or pause. */
    turn() {
        if (this.running) this.pause();
        else {
            this.running = true;
            this.labels();
        }
    }

    pause() {
        this.running = false;
        this.clock = this.k * this.rig.sample_time;
        this.labels();
    }

    single() {
        this.pause();
        this.clock = (this.k + 1) * this.rig.sample_time;
    }

    /** Do what was chosen or pressed in the panel. */
    choose(name, value) {
        const { scene } = this;
        if (name in scene.changes || (this.controls.outputs[name] && name !== "lam")) {
            scene.changes[name] = value;
            for (const lane of this.lanes) lane.use(this.rig);
            this.describe();
        } else if (name === "left" || name === "right") this.exchange(name, value);
        else if (name === "source") {
            scene.source = value;
            fitted(scene);
            this.connect();
        } else if (name === "lam") {
            scene.lam = value;
            if (scene.copies > 1) this.begin();
            else history.replaceState(null, "", hashOf(scene));
        } else if (name === "speed") {
            scene.speed = value;
            history.replaceState(null, "", hashOf(scene));
        } else if (name === "link") copyAddress(find("link"));
        else if (name === "csv-left" || name === "csv-right") saveTable(this.lanes[name === "csv-left" ? 0 : 1]);
        else if (name === "film" || name === "gif") this.recorder.turn(name, find(name));
        else {
            if (name === "restore") scene.changes = {};
            if (name === "place" && value in STARTS) scene.start = [...STARTS[value][1]];
            if (name === "copies") scene.copies = Number(value);
            if (name === "rig") Object.assign(scene, { rig: value, changes: {} });
            if (name === "task")
                Object.assign(scene, {
                    task: value,
                    start: [...STARTS[value === "swing-up" ? "hanging" : "near"][1]],
                });
            if (name === "random") this.drawLots();
            fitted(scene);
            this.begin();
        }
    }

    drawLots() {
        const { scene } = this,
            middle = scene.task === "swing-up" ? Math.PI : 0;
        const angle = () => middle + scene.lam * (2 * Math.random() - 1);
        scene.start = [0, angle(), angle(), 0, 0, 0].map((each) => +each.toFixed(4));
        scene.seed = Math.floor(1e6 * Math.random());
    }

    /** Begin anew from a state. */
    startAt(x) {
        this.scene.start = x.map((each) => +each.toFixed(4));
        this.begin();
    }

    /** Put another controller in charge of a pendulum that goes on from where it stands, if it still does. */
    exchange(side, name) {
        const had = this.lanes[side === "left" ? 0 : 1] ?? this.lanes[0];
        this.scene[side] = name;
        if (!name) this.lanes = this.lanes.slice(0, 1);
        else if (had.ended || this.lanes[0].ended) return this.begin();
        else {
            // All records begin now, so that their curves share a clock.
            const from = (i) => (this.lanes[i] ?? this.lanes[0]).states;
            this.lanes = looksOf(this.names).map((look, i) => new LaneRecord(look, from(i), this.rig));
            this.clock = Math.max(0, this.clock - this.k * this.rig.sample_time);
            this.earlier += this.k;
            this.k = 0;
        }
        return this.describe();
    }
}

/** Return how the named controllers look; the second never has the colour of the first. */
function looksOf(names) {
    const looks = names.map((name) => CATALOGUE.controllers.find((each) => each.name === name)),
        [left, right] = looks;
    if (right?.colour === left.colour)
        looks[1] = { ...right, colour: left.colour === "#000000" ? "#777777" : "#000000" };
    return looks;
}

/** For the console and for tests. */
globalThis.playground = new Page();
