// The panel: what can be chosen and changed, a sentence each.
import { CATALOGUE } from "./catalogue.js";
import { offered, placeOf, SLIDERS, STARTS } from "./scene.js";

/** Return the element of an id. */
export const find = (id) => document.getElementById(id);

/** Make an element. */
export function make(tag, properties = {}, ...children) {
    const element = Object.assign(document.createElement(tag), properties);
    element.append(...children);
    return element;
}

const SAFE = Math.max(...CATALOGUE.saved.lambdas.filter((lam, i) => CATALOGUE.saved.shares[i] > 0.9999));
const TASKS = { balance: "Balance", "swing-up": "Swing up", none: "No task" };
const SOURCES = { python: "in Python", tab: "in this tab" };

/** Build the panel into two forms; chosen(name, value) is called at every choice. */
export class Controls {
    constructor(form, plant, scene, chosen) {
        Object.assign(this, { scene, chosen, inputs: {}, outputs: {} });
        for (const each of [form, plant]) each.addEventListener("submit", (event) => event.preventDefault());
        form.append(
            this.group(
                "Who balances what",
                this.choice("left", "Left pendulum", "Its controller, drawn in the same colour everywhere."),
                this.choice(
                    "right",
                    "Right pendulum",
                    "A second controller under the same pushes and noise, or none.",
                ),
                this.choice(
                    "task",
                    "Task",
                    "Balancing ends when a link falls; swinging up, only at the end of the track; without a task it goes on.",
                ),
                this.choice("rig", "Rig", "The plant, with the masses, lengths and limits of its source."),
                this.choice(
                    "source",
                    "Computed",
                    "Python runs every controller; the tab alone runs those that are formulas.",
                ),
            ),
            this.group(
                "Where it starts",
                this.choice(
                    "place",
                    "Start",
                    "Or pause, and drag the cart and the links to where they should begin.",
                ),
                this.button(
                    "random",
                    "Another random start",
                    "Both angles within λ of upright, or of hanging where the task is to swing up.",
                ),
                this.slider(
                    "lam",
                    "λ, the largest starting angle",
                    "rad",
                    0.05,
                    0.8,
                    0.01,
                    `Larger is harder; on ${CATALOGUE.saved.rig}, beyond ${SAFE} rad not all starts can be saved.`,
                ),
                this.choice("copies", "Race", "Many copies from random starts, and the share that still stands."),
            ),
            this.group(
                "Take it home",
                this.button(
                    "link",
                    "Copy the link",
                    "The address of this page is the scene; sending it is enough.",
                ),
                make(
                    "div",
                    { className: "control" },
                    make(
                        "div",
                        { className: "pair" },
                        this.press("csv-left", "Left as CSV"),
                        this.press("csv-right", "Right as CSV"),
                    ),
                    make("small", { textContent: "Every sample since the start, as dpend.Run.from_csv reads it." }),
                ),
                make(
                    "div",
                    { className: "control" },
                    make("div", { className: "pair" }, this.press("film", "Film"), this.press("gif", "GIF")),
                    make("small", {
                        textContent: "Press to begin, and again to end; a GIF ends after half a minute.",
                    }),
                ),
            ),
        );
        const sliders = Object.entries(SLIDERS).map(([name, [label, ...more]]) =>
            this.slider(name, label, ...more),
        );
        const restore = this.button("restore", "As the rig has it", "Undoes all changes of the plant.");
        plant.append(this.group("The plant, while it runs: the controllers do not know", ...sliders, restore));
        this.show();
    }

    group(title, ...controls) {
        return make("fieldset", {}, make("legend", { textContent: title }), ...controls);
    }

    choice(name, label, about) {
        const input = make("select", { id: name });
        input.addEventListener("change", () => this.chosen(name, input.value));
        this.inputs[name] = input;
        return this.labelled(input, label, about);
    }

    slider(name, label, unit, least, most, step, about) {
        const input = make("input", { id: name, type: "range", min: least, max: most, step });
        const output = make("output", {});
        output.htmlFor = name;
        input.addEventListener("input", () => {
            output.textContent = `${input.value} ${unit}`;
            this.chosen(name, Number(input.value));
        });
        this.inputs[name] = input;
        this.outputs[name] = { output, unit };
        return this.labelled(input, label, about, output);
    }

    labelled(input, label, about, ...more) {
        const said = make("small", { id: `${input.id}-about`, textContent: about });
        input.setAttribute("aria-describedby", said.id);
        const named = make("label", { htmlFor: input.id }, make("span", { textContent: label }), ...more);
        return make("div", { className: "control" }, named, input, said);
    }

    press(name, label) {
        const button = make("button", { id: name, type: "button", textContent: label });
        button.addEventListener("click", () => this.chosen(name));
        this.inputs[name] = button;
        return button;
    }

    button(name, label, about) {
        const button = this.press(name, label),
            said = make("small", { id: `${name}-about`, textContent: about });
        button.setAttribute("aria-describedby", said.id);
        return make("div", { className: "control" }, button, said);
    }

    /** Show a scene as it is now. */
    show(scene = this.scene) {
        this.scene = scene;
        const { inputs } = this,
            names = offered(scene);
        const kinds = { designed: "Designed", learned: "Learned", own: "Your own" };
        for (const side of ["left", "right"]) {
            const groups = Object.entries(kinds).map(([kind, label]) => {
                const options = names
                    .filter((each) => each.kind === kind)
                    .map((each) => new Option(each.name, each.name));
                return make("optgroup", { label }, ...options);
            });
            inputs[side].replaceChildren(...groups.filter((group) => group.children.length));
            if (side === "right") inputs[side].prepend(new Option("none", ""));
            inputs[side].value = scene[side];
        }
        fill(inputs.task, Object.entries(TASKS), scene.task);
        fill(
            inputs.rig,
            Object.keys(CATALOGUE.rigs).map((name) => [name, name]),
            scene.rig,
        );
        inputs.rig.title = CATALOGUE.rigs[scene.rig].about;
        fill(
            inputs.source,
            Object.entries(SOURCES).filter(([name]) => CATALOGUE.python || name === "tab"),
            scene.source,
        );
        fill(
            inputs.place,
            [...Object.entries(STARTS).map(([name, [label]]) => [name, label]), ["own", "as dragged or drawn"]],
            placeOf(scene.start) ?? "own",
        );
        const counts = [1, 100, 200, 500];
        if (!counts.includes(scene.copies)) counts.push(scene.copies);
        fill(
            inputs.copies,
            counts.map((n) => [n, n === 1 ? "one pendulum each" : `${n} copies each`]),
            scene.copies,
        );
        this.set("lam", scene.lam);
        const rig = CATALOGUE.rigs[scene.rig],
            own = { ...rig, ...rig.params };
        for (const name of Object.keys(SLIDERS))
            this.set(name, scene.changes[name] ?? own[name] ?? Number(inputs[name].max));
        inputs["csv-right"].disabled = !scene.right;
        inputs["csv-left"].disabled = scene.copies > 1;
        if (scene.copies > 1) inputs["csv-right"].disabled = true;
    }

    set(name, value) {
        this.inputs[name].value = value;
        this.outputs[name].output.textContent = `${+Number(value).toFixed(3)} ${this.outputs[name].unit}`;
    }
}

function fill(select, options, value) {
    select.replaceChildren(...options.map(([name, label]) => new Option(label, name)));
    select.value = value;
}

const FIGURES = [
    ["seconds", "Time", "s", 1, "How long it has lasted."],
    ["standing", "Still going", "%", 1, "Of all copies."],
    ["up", "Both links up", "s", 1, "Without a break, each within 0.2 rad."],
    [
        "variation",
        "Changes of force",
        "u_max/s",
        2,
        "All changes added up, per second, in units of the limit: small is smooth.",
    ],
    ["switches", "Switches of sign", "1/s", 1, "How often the force turns round."],
    ["saturated", "At the limit", "%", 0, "Share of the time at full force."],
    ["effort", "Effort", "N² s", 0, "The integral of the force squared."],
    ["ms", "One step", "ms", 2, "What the controller takes to decide, in Python."],
];

/** Show the figures of all lanes in a table. */
export function showFigures(table, lanes) {
    const said = lanes.map((lane) => lane.figures());
    const heading = lanes[0].single ? "So far" : "First copy of each, so far",
        key = [heading, ...lanes.map((lane) => lane.name)].join("|");
    if (table.dataset.for !== key) {
        table.dataset.for = key;
        const heads = [
            make("th", { textContent: heading }),
            ...lanes.map((lane) => make("th", { scope: "col", textContent: lane.name })),
        ];
        const rows = FIGURES.map(([name, label, unit, , about]) =>
            make(
                "tr",
                {},
                make(
                    "th",
                    { scope: "row" },
                    `${label}, ${unit}`,
                    make("small", { textContent: about, className: "soft" }),
                ),
                ...lanes.map(() => make("td", { className: name })),
            ),
        );
        table.replaceChildren(make("thead", {}, make("tr", {}, ...heads)), make("tbody", {}, ...rows));
    }
    FIGURES.forEach(([name, , unit, digits], row) =>
        said.forEach((figures, i) => {
            const value = figures[name],
                text = value === null ? "–" : (unit === "%" ? 100 * value : value).toFixed(digits);
            const cell = table.tBodies[0].rows[row].cells[i + 1];
            if (cell.textContent !== text) cell.textContent = text;
        }),
    );
}
