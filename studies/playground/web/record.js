// What a visitor can take home: a table that dpend.Run.from_csv reads, a film of the stage, a GIF.
import { gifOf } from "./gif.js";

const HEADINGS = "t,pos,th1,th2,vel,om1,om2,u,push_cart,push_link1,push_link2";

/** Return a lane's run as a table: a line a sample, the force and the push from then on. */
export function csvOf(lane) {
    const lines = lane.x.map((x, k) => {
        const last = k < lane.u.length ? [lane.u[k], ...lane.pushes[k]] : [0, 0, 0, 0];
        return [+lane.t[k].toFixed(9), ...x, ...last].join();
    });
    return `${HEADINGS}\n${lines.join("\n")}\n`;
}

/** Hand a file over. */
export function save(name, blob) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

/** A film of a canvas in what this browser can record: WebM, or MP4 where it knows no other. */
export class Film {
    constructor(canvas) {
        const kinds = ["video/webm;codecs=vp9", "video/webm", "video/mp4"];
        this.kind = globalThis.MediaRecorder
            ? kinds.find((kind) => MediaRecorder.isTypeSupported(kind))
            : undefined;
        if (!this.kind) throw new Error("This browser records no film; take the GIF.");
        this.parts = [];
        this.recorder = new MediaRecorder(canvas.captureStream(30), {
            mimeType: this.kind,
            videoBitsPerSecond: 4e6,
        });
        this.recorder.ondataavailable = (event) => this.parts.push(event.data);
        this.recorder.start(500);
    }

    /** End it, and hand the file over. */
    stop() {
        this.recorder.onstop = () => {
            const ending = this.kind.includes("mp4") ? "mp4" : "webm";
            save(`double-pendulum.${ending}`, new Blob(this.parts, { type: this.kind.split(";")[0] }));
        };
        this.recorder.stop();
    }
}

/** A GIF of a canvas, a picture every 80 ms and at most half a minute of them, half the size of the screen's. */
export class Pictures {
    constructor(canvas) {
        this.canvas = canvas;
        this.small = document.createElement("canvas");
        const scale = Math.min(1, 720 / canvas.width);
        this.small.width = Math.round(canvas.width * scale);
        this.small.height = Math.round(canvas.height * scale);
        this.frames = [];
        this.due = 0;
    }

    get full() {
        return this.frames.length >= 375;
    }

    /** Take a picture, if one is due. */
    take(now) {
        if (now < this.due || this.full) return;
        this.due = Math.max(this.due + 80, now + 40);
        const pen = this.small.getContext("2d", { willReadFrequently: true });
        pen.drawImage(this.canvas, 0, 0, this.small.width, this.small.height);
        this.frames.push(pen.getImageData(0, 0, this.small.width, this.small.height).data);
    }

    stop() {
        save(
            "double-pendulum.gif",
            new Blob([gifOf(this.frames, this.small.width, this.small.height, 8)], { type: "image/gif" }),
        );
    }
}

/** What is being recorded of a canvas, and the buttons that say so. */
export class Recorder {
    constructor(canvas, notice) {
        Object.assign(this, { canvas, notice, film: null, gif: null });
    }

    /** Begin a film or a GIF, or end it. */
    turn(kind, button) {
        try {
            if (this[kind]) {
                this[kind].stop();
                this[kind] = null;
            } else this[kind] = new (kind === "film" ? Film : Pictures)(this.canvas);
        } catch (error) {
            this.notice(error.message);
        }
        button.setAttribute("aria-pressed", Boolean(this[kind]));
        button.textContent = this[kind] ? "End it" : kind === "film" ? "Film" : "GIF";
    }

    /** Take a picture, if one is due, and return whether there is no room for another. */
    take() {
        this.gif?.take(performance.now());
        return Boolean(this.gif?.full);
    }
}

/** Hand a lane's table over. */
export function saveTable(lane) {
    if (lane) save(`${lane.name.replace(/\W+/g, "-")}.csv`, new Blob([csvOf(lane)], { type: "text/csv" }));
}

/** Copy the page's address, and let a button say for a while whether that was possible. */
export function copyAddress(button) {
    const copied = navigator.clipboard?.writeText(location.href) ?? Promise.reject(new Error());
    button.dataset.label ??= button.textContent;
    copied.then(
        () => (button.textContent = "Copied"),
        () => (button.textContent = "Copy the address above"),
    );
    setTimeout(() => (button.textContent = button.dataset.label), 3000);
}
