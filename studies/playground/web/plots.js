// Curves against time: forces, angles, energy, shares.
import { wrapped } from "./lane.js";

export const WINDOW = 6; // s

/** Return the colours of the page's theme. */
export function themeOf(element) {
    const style = getComputedStyle(element),
        read = (name) => style.getPropertyValue(`--${name}`).trim();
    return Object.fromEntries(["ink", "paper", "soft", "line", "push", "fallen"].map((name) => [name, read(name)]));
}

const LEAST_CONTRAST = 3; // of lines, by the guidelines for accessible pages
const parts = (colour) => [1, 3, 5].map((i) => parseInt(colour.slice(i, i + 2), 16) / 255);

function luminance(rgb) {
    const [r, g, b] = rgb.map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

/** Return a contender's colour in a theme: black is the ink's, and what is too dark for a dark page is lightened. */
export function inkOf(look, theme) {
    if (look.colour === "#000000") return theme.ink;
    if (theme.paper.length !== 7) return look.colour; // white
    const ground = luminance(parts(theme.paper));
    let rgb = parts(look.colour);
    while ((luminance(rgb) + 0.05) / (ground + 0.05) < LEAST_CONTRAST) rgb = rgb.map((v) => v + 0.1 * (1 - v));
    return `rgb(${rgb.map((v) => Math.round(255 * v)).join()})`;
}

/** Return a canvas pattern of dashes for matplotlib's name of a line. */
export function dashesOf(line) {
    if (Array.isArray(line)) return line[1].map((each) => 2 * each);
    return { "-": [], "--": [7, 4], "-.": [7, 3, 2, 3], ":": [2, 3] }[line];
}

/** Make a canvas as sharp as the screen, and return its context and its size in CSS pixels. */
export function sharp(canvas, width, height) {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
    }
    canvas.style.height = `${height}px`;
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    return pen;
}

/** Draw the frame of a plot: its heading, least and greatest value, and a line at zero or another level. */
export function frame(pen, box, theme, heading, range, level = 0) {
    pen.strokeStyle = theme.line;
    pen.lineWidth = 1;
    pen.setLineDash([]);
    pen.strokeRect(box.x + 0.5, box.y + 0.5, box.w - 1, box.h - 1);
    const y = yOf(box, range, level);
    if (y > box.y && y < box.y + box.h) {
        pen.beginPath();
        pen.moveTo(box.x, y);
        pen.lineTo(box.x + box.w, y);
        pen.stroke();
    }
    pen.fillStyle = theme.soft;
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "left";
    pen.fillText(heading, box.x, box.y - 5);
    pen.textAlign = "right";
    const worded = (value) => value.toFixed(range[1] - range[0] < 10 ? 1 : 0).replace("-", "−");
    pen.fillText(worded(range[1]), box.x - 4, box.y + 9);
    pen.fillText(worded(range[0]), box.x - 4, box.y + box.h);
}

const yOf = (box, [low, high], value) => box.y + box.h - ((value - low) / (high - low)) * box.h;

/** Draw values h seconds apart up to a time: held ones as a staircase, angles without the jumps of whole turns. */
export function curve(
    pen,
    box,
    range,
    values,
    h,
    end,
    { colour, dashes = [], width = 2, held = false, turns = false },
) {
    const first = Math.max(0, Math.floor((end - WINDOW) / h)),
        from = Math.max(end, WINDOW) - WINDOW;
    pen.save();
    pen.beginPath();
    pen.rect(box.x, box.y - 1, box.w, box.h + 2);
    pen.clip();
    pen.beginPath();
    for (let k = first; k < values.length && k * h <= end; k++) {
        const x = box.x + ((k * h - from) / WINDOW) * box.w,
            y = yOf(box, range, values[k]);
        if (k === first || (turns && Math.abs(values[k] - values[k - 1]) > Math.PI)) pen.moveTo(x, y);
        else pen.lineTo(x, y);
        if (held) pen.lineTo(box.x + ((Math.min((k + 1) * h, end) - from) / WINDOW) * box.w, y);
    }
    Object.assign(pen, { strokeStyle: colour, lineWidth: width, lineJoin: "round" });
    pen.setLineDash(dashes);
    pen.stroke();
    pen.restore();
}

/** Return a range that holds all values shown, and grows in steps so that it does not jump at every sample. */
export function rangeOf(lists, h, end, least) {
    let most = least;
    for (const values of lists) {
        for (let k = Math.max(0, Math.floor((end - WINDOW) / h)); k < values.length; k++)
            most = Math.max(most, Math.abs(values[k]));
    }
    return least * 2 ** Math.ceil(Math.log2(most / least) - 1e-9);
}

/** Draw angles and energy of all lanes, one plot beside or under the other. */
export function drawPlots(canvas, lanes, time) {
    const theme = themeOf(canvas),
        width = canvas.clientWidth,
        wide = width >= 640;
    const height = wide ? 170 : 320,
        pen = sharp(canvas, width, height);
    pen.fillStyle = theme.paper;
    pen.fillRect(0, 0, width, height);
    const w = wide ? width / 2 - 52 : width - 46,
        h = 120;
    const boxes = [{ x: 40, y: 26, w, h }, wide ? { x: width / 2 + 46, y: 26, w, h } : { x: 40, y: 186, w, h }];
    const step = lanes[0].rig.sample_time;
    const recent = Math.max(0, Math.floor((time - WINDOW) / step) - 1);
    const lists = lanes.map((lane) =>
        [1, 2].map((i) => {
            const values = new Array(lane.x.length);
            for (let k = recent; k < values.length; k++) values[k] = wrapped(lane.x[k][i]);
            return values;
        }),
    );
    const most = Math.min(rangeOf(lists.flat(), step, time, 0.2), Math.PI);
    frame(pen, boxes[0], theme, "angles, rad: lower link solid, upper dashed", [-most, most]);
    lanes.forEach((lane, i) =>
        lists[i].forEach((values, j) => {
            curve(pen, boxes[0], [-most, most], values, step, time, {
                colour: inkOf(lane.look, theme),
                dashes: j ? [5, 4] : [],
                turns: true,
            });
        }),
    );
    const up = lanes[0].upright,
        above = rangeOf(
            lanes.map((lane) => lane.energy),
            step,
            time,
            up || 1,
        );
    frame(pen, boxes[1], theme, "energy, J: the line is that of standing upright", [-above, above], up);
    for (const lane of lanes) {
        curve(pen, boxes[1], [-above, above], lane.energy, step, time, {
            colour: inkOf(lane.look, theme),
            dashes: dashesOf(lane.look.line),
        });
    }
}
