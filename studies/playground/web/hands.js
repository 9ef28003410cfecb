// Hands on the pendulums: pushes by pointer, key and button, and starts by dragging while they are paused.
import { find } from "./controls.js";

const PART_KEYS = { 1: 0, 2: 1, 3: 2 };
const GENTLE = [1, 0.05, 0.02]; // a link falls where a cart would hardly be moved
const FULL = 60; // pixels that a pointer pulls for a push of full strength
const TAP = 0.2; // s that a push by a button lasts that was pressed by a key

export class Hands {
    /** Watch pointer, keys and buttons for a page; canvas is where its pendulums are. */
    constructor(page, canvas) {
        this.page = page;
        this.push = [0, 0, 0];
        this.tap = 0; // samples that a push still lasts
        this.drag = null;
        this.buttons();
        this.pointer(canvas);
        this.keys();
    }

    /** Return the push of the next samples. */
    pushFor(samples) {
        const push = [...this.push];
        if (this.tap > 0) {
            this.tap -= samples;
            if (this.tap <= 0) this.release();
        }
        return push;
    }

    buttons() {
        find("part").addEventListener("change", () => this.showStrength());
        find("strength").addEventListener("input", () => this.showStrength());
        for (const [id, sign] of Object.entries({ "push-left": -1, "push-right": 1 })) {
            const button = find(id);
            button.addEventListener("pointerdown", (event) => {
                button.setPointerCapture(event.pointerId);
                this.press(sign);
            });
            for (const end of ["pointerup", "pointercancel"]) button.addEventListener(end, () => this.release());
            button.addEventListener("click", (event) => event.detail === 0 && this.nudge(sign)); // by a key
        }
        this.showStrength();
    }

    get part() {
        return Number(find("part").value);
    }

    /** Return how strong a push on a part is: N on the cart, on a link N m by key and N by pointer. */
    strengthOn(part) {
        return Number(find("strength").value) * GENTLE[part];
    }

    showStrength() {
        const strength = +this.strengthOn(this.part).toFixed(2);
        find("strength-out").textContent = `${strength} ${this.part === 0 ? "N" : "N m"}`;
    }

    press(sign) {
        this.release();
        this.push[this.part] = sign * this.strengthOn(this.part);
    }

    nudge(sign) {
        this.press(sign);
        this.tap = Math.max(1, Math.round(TAP / this.page.rig.sample_time));
    }

    release() {
        this.tap = 0;
        this.push = [0, 0, 0];
    }

    pointer(canvas) {
        const { page } = this,
            at = (event) => ({ x: event.offsetX, y: event.offsetY });
        const reach = (event) => (event.pointerType === "mouse" ? 22 : 34);
        const onTouch = (event) => {
            const box = canvas.getBoundingClientRect(),
                touch = event.touches[0];
            const found = page.stage.touched(touch.clientX - box.x, touch.clientY - box.y, 34);
            if (found) event.preventDefault(); // no scrolling then
        };
        canvas.addEventListener("touchstart", onTouch, { passive: false });
        canvas.addEventListener("pointerdown", (event) => {
            const from = at(event),
                found = page.stage.touched(from.x, from.y, reach(event));
            if (!found) return;
            canvas.setPointerCapture(event.pointerId);
            this.drag = { ...found, from, to: from };
        });
        canvas.addEventListener("pointermove", (event) => {
            if (!this.drag) return;
            this.drag.to = at(event);
            if (page.running) this.pull();
            else if (page.scene.copies === 1) this.place();
        });
        for (const end of ["pointerup", "pointercancel"]) {
            canvas.addEventListener(end, () => {
                this.drag = null;
                this.release();
            });
        }
    }

    /** Push where the pointer pulls: the force at the point touched, as generalised forces that both pendulums get. */
    pull() {
        const { part, along, view, from, to } = this.drag,
            strength = this.strengthOn(part) / FULL;
        const fx = (to.x - from.x) * strength,
            fy = (from.y - to.y) * strength,
            [, th1, th2] = view.lane.states;
        const torque = (length, th) => length * (fx * Math.cos(th) - fy * Math.sin(th));
        this.tap = 0;
        this.push = [fx, 0, 0];
        if (part === 1) this.push[1] = torque(along * view.length1, th1);
        if (part === 2) this.push.splice(1, 2, torque(view.length1, th1), torque(along * view.length2, th2));
    }

    /** Move the start to where the pointer is. */
    place() {
        const { part, view, to } = this.drag,
            x = [...this.page.lanes[0].states.slice(0, 3), 0, 0, 0];
        const right = (to.x - view.cx) / view.scale,
            above = (view.cy - to.y) / view.scale,
            end = 0.95 * (view.track ?? Infinity);
        if (part === 0) x[0] = Math.max(-end, Math.min(end, right));
        if (part === 1) x[1] = Math.atan2(right - x[0], above);
        if (part === 2) {
            x[2] = Math.atan2(right - x[0] - view.length1 * Math.sin(x[1]), above - view.length1 * Math.cos(x[1]));
        }
        this.page.startAt(x);
    }

    keys() {
        const { page } = this;
        addEventListener("keydown", (event) => {
            const typing = event.target.closest?.("input, select, textarea"),
                pressing = event.target.closest?.("button");
            if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
            const sign = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
            if (sign) {
                if (!event.repeat) this.press(sign);
            } else if (event.key in PART_KEYS) {
                find("part").value = PART_KEYS[event.key];
                this.showStrength();
            } else if (event.key === " " && !pressing) page.turn();
            else if (event.key === ".") page.single();
            else if (event.key === "r" || event.key === "R") page.begin();
            else return;
            event.preventDefault();
        });
        addEventListener("keyup", (event) => {
            if (event.key.startsWith("Arrow")) this.release();
        });
        addEventListener("blur", () => this.release());
    }
}
