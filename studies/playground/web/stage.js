// The stage: every lane's pendulums, under them its force or the share that stands, and what a pointer touches.
import { curve, dashesOf, frame, inkOf, rangeOf, sharp, themeOf } from "./plots.js";
import { ENDS } from "./tab.js";
import { savable } from "./scene.js";

const EPISODE = 300,
    HOLD = 1; // samples of dpend.Balance, and seconds of dpend.SwingUp
const TRACE = 84,
    HEAD = 46,
    GAP = 24,
    LEFT = 40;

export class Stage {
    constructor(canvas) {
        this.canvas = canvas;
        this.views = [];
    }

    /** Draw lanes as they stood at a time. */
    draw({ scene, lanes, time, drag }) {
        const { canvas } = this,
            theme = themeOf(canvas),
            width = canvas.clientWidth;
        const beside = width >= 640 && lanes.length > 1,
            rows = beside ? 1 : lanes.length;
        const w = beside ? width / 2 : width,
            most = beside || lanes.length === 1 ? 380 : 260;
        const picture = Math.min(most, Math.max(...lanes.map((lane) => neededBy(lane, scene, w))));
        const height = rows * (HEAD + picture + GAP + TRACE + 16);
        const pen = sharp(canvas, width, height);
        pen.fillStyle = theme.paper;
        pen.fillRect(0, 0, width, height);
        this.views = lanes.map((lane, i) => {
            const box = { x: beside ? i * w : 0, y: beside ? 0 : (i * height) / rows, w, h: picture };
            const view = this.viewOf(lane, scene, { ...box, y: box.y + HEAD });
            this.heading(pen, lane, box, theme, scene);
            this.pendulums(pen, lane, view, theme, lane.at(time));
            this.trace(
                pen,
                lane,
                lanes,
                { x: box.x + LEFT, y: box.y + HEAD + picture + GAP, w: w - LEFT - 8, h: TRACE },
                theme,
                time,
                scene,
            );
            return view;
        });
        if (drag) this.arrow(pen, drag, theme);
    }

    /** Return how metres become pixels: the whole track, or where there is none, what is near the cart. */
    viewOf(lane, scene, box) {
        const { length1, length2 } = lane.rig.params,
            track = lane.rig.track_limit,
            { half, low, high } = extentOf(lane, scene);
        const scale = Math.min((box.w - 16) / (2 * half), box.h / (low + high));
        const middle = track === null ? lane.states[0] : 0;
        return {
            box,
            scale,
            cx: box.x + box.w / 2 - scale * middle,
            cy: box.y + box.h - low * scale,
            track,
            length1,
            length2,
            lane,
        };
    }

    heading(pen, lane, box, theme, scene) {
        pen.textAlign = "left";
        pen.fillStyle = theme.ink;
        pen.font = "600 16px system-ui, sans-serif";
        pen.fillText(lane.name, box.x + 44, box.y + 18);
        pen.strokeStyle = inkOf(lane.look, theme);
        pen.lineWidth = 3;
        pen.setLineDash(dashesOf(lane.look.line));
        pen.beginPath();
        pen.moveTo(box.x + 10, box.y + 13);
        pen.lineTo(box.x + 38, box.y + 13);
        pen.stroke();
        pen.font = "13px system-ui, sans-serif";
        pen.fillStyle = theme.soft;
        const words = lane.failed || wordsOf(lane, scene);
        pen.fillText(words, box.x + 10, box.y + 38, box.w - 20);
    }

    pendulums(pen, lane, view, theme, states) {
        const { scale, cx, cy, track, box } = view;
        pen.save();
        pen.beginPath();
        pen.rect(box.x, box.y, box.w, box.h);
        pen.clip();
        pen.setLineDash([]);
        pen.strokeStyle = theme.line;
        pen.lineWidth = 2;
        pen.beginPath();
        const half = track ?? 1e3;
        pen.moveTo(cx - half * scale, cy + 9);
        pen.lineTo(cx + half * scale, cy + 9);
        if (track !== null) {
            for (const end of [-track, track]) {
                pen.moveTo(cx + end * scale, cy - 6);
                pen.lineTo(cx + end * scale, cy + 16);
            }
        } else {
            for (let mark = Math.floor((box.x - cx) / scale); mark < (box.x + box.w - cx) / scale; mark++) {
                pen.moveTo(cx + mark * scale, cy + 9);
                pen.lineTo(cx + mark * scale, cy + 14);
            }
        }
        pen.stroke();
        const n = states.length / 6,
            many = n > 1,
            at = (i, j) => states[6 * i + j];
        const colour = inkOf(lane.look, theme);
        pen.lineCap = "round";
        for (const fallen of many ? [true, false] : [Boolean(lane.codes[0])]) {
            pen.globalAlpha = many ? (fallen ? 0.12 : Math.max(0.4, Math.min(0.8, 60 / n))) : fallen ? 0.45 : 1;
            pen.lineWidth = many ? 1.5 : 6;
            pen.strokeStyle = fallen && many ? theme.fallen : colour;
            pen.beginPath();
            for (let i = 0; i < n; i++) {
                if (Boolean(lane.codes[i]) !== fallen) continue;
                const x0 = cx + at(i, 0) * scale,
                    [th1, th2] = [at(i, 1), at(i, 2)];
                const x1 = x0 + view.length1 * scale * Math.sin(th1),
                    y1 = cy - view.length1 * scale * Math.cos(th1);
                pen.moveTo(x0, cy);
                pen.lineTo(x1, y1);
                pen.lineTo(x1 + view.length2 * scale * Math.sin(th2), y1 - view.length2 * scale * Math.cos(th2));
            }
            pen.stroke();
            if (many) continue;
            const [x0, th1] = [cx + at(0, 0) * scale, at(0, 1)];
            pen.fillStyle = theme.ink;
            pen.fillRect(x0 - 22, cy - 8, 44, 16);
            pen.fillStyle = theme.paper;
            for (const [x, y] of [
                [x0, cy],
                [x0 + view.length1 * scale * Math.sin(th1), cy - view.length1 * scale * Math.cos(th1)],
            ]) {
                pen.beginPath();
                pen.arc(x, y, 3, 0, 2 * Math.PI);
                pen.fill();
            }
        }
        pen.restore();
    }

    trace(pen, lane, lanes, box, theme, time, scene) {
        const h = lane.rig.sample_time,
            look = { colour: inkOf(lane.look, theme), dashes: [], width: 1.5, held: true };
        if (lane.single) {
            const limit =
                lane.rig.force_limit ??
                rangeOf(
                    lanes.map((each) => each.u),
                    h,
                    time,
                    10,
                );
            frame(pen, box, theme, "force, N", [-limit, limit]);
            curve(pen, box, [-limit, limit], lane.u, h, time, look);
            return;
        }
        const best = savable(scene),
            known = Number.isFinite(best);
        frame(pen, box, theme, known ? "share standing; dashed: best known" : "share standing", [0, 1]);
        if (known) {
            const y = box.y + box.h * (1 - best);
            pen.setLineDash([6, 4]);
            pen.strokeStyle = theme.ink;
            pen.beginPath();
            pen.moveTo(box.x, y);
            pen.lineTo(box.x + box.w, y);
            pen.stroke();
        }
        curve(pen, box, [0, 1], lane.share, h, time, look);
    }

    arrow(pen, { from, to }, theme) {
        const angle = Math.atan2(to.y - from.y, to.x - from.x);
        pen.setLineDash([]);
        pen.strokeStyle = theme.push;
        pen.lineWidth = 4;
        pen.beginPath();
        pen.moveTo(from.x, from.y);
        pen.lineTo(to.x, to.y);
        for (const turn of [2.6, -2.6]) {
            pen.moveTo(to.x, to.y);
            pen.lineTo(to.x + 12 * Math.cos(angle + turn), to.y + 12 * Math.sin(angle + turn));
        }
        pen.stroke();
    }

    /** Return what is under a pointer: a view, a part (0 cart, 1 lower, 2 upper link) and how far along it; or null. */
    touched(x, y, near) {
        let found = null;
        for (const view of this.views) {
            const [pos, th1, th2] = view.lane.states,
                x0 = view.cx + pos * view.scale,
                y0 = view.cy;
            const x1 = x0 + view.length1 * view.scale * Math.sin(th1),
                y1 = y0 - view.length1 * view.scale * Math.cos(th1);
            const x2 = x1 + view.length2 * view.scale * Math.sin(th2),
                y2 = y1 - view.length2 * view.scale * Math.cos(th2);
            const parts = [
                { part: 0, ...foot(x, y, x0 - 22, y0, x0 + 22, y0), along: 0 },
                { part: 1, ...foot(x, y, x0, y0, x1, y1) },
                { part: 2, ...foot(x, y, x1, y1, x2, y2) },
            ];
            for (const each of parts) if (each.away <= (found?.away ?? near)) found = { ...each, view };
        }
        return found;
    }
}

/** Return how far the picture reaches to either side of the middle, below and above the cart, m. */
function extentOf(lane, scene) {
    const { length1, length2 } = lane.rig.params,
        reach = length1 + length2,
        track = lane.rig.track_limit;
    const half = track === null ? Math.max(2.4, 1.2 * reach) : track + 0.35;
    return { half, low: scene.task === "balance" ? 0.35 : reach + 0.1, high: reach + 0.15 };
}

/** Return the height that a picture of some width takes, px. */
function neededBy(lane, scene, width) {
    const { half, low, high } = extentOf(lane, scene);
    return Math.round(((width - 16) / (2 * half)) * (low + high));
}

/** Return how far a point is from a line between two others, and where along it the nearest point lies. */
function foot(x, y, ax, ay, bx, by) {
    const dx = bx - ax,
        dy = by - ay,
        square = dx * dx + dy * dy || 1;
    const along = Math.max(0, Math.min(1, ((x - ax) * dx + (y - ay) * dy) / square));
    return { along, away: Math.hypot(x - ax - along * dx, y - ay - along * dy) };
}

/** Say how a lane stands. */
export function wordsOf(lane, scene) {
    if (!lane.single) {
        const n = lane.codes.length,
            standing = lane.codes.filter((code) => !code).length,
            best = savable(scene);
        const known = Number.isFinite(best) ? `; best known ${(100 * best).toFixed(1)} %` : "";
        return `${standing} of ${n} still going (${((100 * standing) / n).toFixed(1)} %)${known}`;
    }
    if (lane.codes[0]) return ENDS[lane.codes[0]];
    const { up } = lane.figures(),
        episode = EPISODE * lane.rig.sample_time;
    if (scene.task === "balance") {
        const done = lane.u.length >= EPISODE ? `: success, an episode lasts ${+episode.toFixed(2)} s` : "";
        return `${lane.seconds.toFixed(1)} s standing${done}`;
    }
    const done = up >= HOLD && scene.task === "swing-up" ? ": success" : "";
    return up > 0 ? `both links up for ${up.toFixed(1)} s${done}` : "not up yet";
}
