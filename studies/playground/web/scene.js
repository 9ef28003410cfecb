// A scene is its address: what is not as at first stands after the # of the URL.
import { CATALOGUE } from "./catalogue.js";
import { Noise } from "./physics.js";
import { worksInTab } from "./tab.js";

export const SLIDERS = {
    cart_mass: ["Cart’s mass", "kg", 0.2, 5, 0.05, "A heavier cart answers the same force more slowly."],
    mass1: ["Lower link’s mass", "kg", 0.05, 2, 0.05, "The link on the cart."],
    mass2: ["Upper link’s mass", "kg", 0.05, 2, 0.05, "The link on top, the harder one to change."],
    length1: ["Lower link’s length", "m", 0.3, 2, 0.05, "Longer links fall more slowly."],
    length2: [
        "Upper link’s length",
        "m",
        0.3,
        2,
        0.05,
        "Change it and see who still copes: the controllers do not know.",
    ],
    cart_friction: ["Cart friction", "N s/m", 0, 10, 0.1, "Grows with the cart’s speed."],
    joint1_friction: ["Lower joint friction", "N m s", 0, 0.5, 0.01, "Grows with the lower link’s rate."],
    joint2_friction: [
        "Upper joint friction",
        "N m s",
        0,
        0.5,
        0.01,
        "Grows with the rate between the links.",
    ],
    force_limit: ["Force limit", "N", 1, 100, 1, "The most that the motor gives, whatever it is asked for."],
    sensor_noise: [
        "Sensor noise",
        "m, rad, m/s, rad/s",
        0,
        0.1,
        0.001,
        "Each measurement is off by about this much.",
    ],
    sensor_delay: ["Sensor delay", "samples", 0, 10, 1, "The controller sees the past."],
    force_noise: ["Force noise", "N", 0, 10, 0.1, "The motor gives about this much more or less."],
    actuator_delay: ["Motor delay", "samples", 0, 10, 1, "The force comes late."],
    actuator_lag: ["Motor lag", "s", 0, 0.2, 0.005, "The force follows the command with this time constant."],
};

export const STARTS = {
    near: ["near upright", [0, 0.12, -0.08, 0, 0, 0]],
    hanging: ["hanging", [0, Math.PI, Math.PI, 0, 0, 0]],
    side: ["both links horizontal", [0, Math.PI / 2, Math.PI / 2, 0, 0, 0]],
};

const FIRST = {
    rig: "gustafsson2016",
    task: "balance",
    left: "Q tuned",
    right: "LQR",
    start: STARTS.near[1],
    copies: 1,
    lam: 0.3,
    seed: 0,
    speed: 1,
    source: CATALOGUE.python ? "python" : "tab",
    changes: {},
};

const rounded = (start) => start.map((each) => +each.toFixed(4)).join();

/** Return the name of a start, if it has one. */
export const placeOf = (start) => Object.keys(STARTS).find((name) => rounded(STARTS[name][1]) === rounded(start));

/** Return the scene that a URL's # describes; what is unknown or out of range stays as at first. */
export function sceneOf(hash) {
    const words = new URLSearchParams(hash.slice(1)),
        scene = structuredClone(FIRST);
    const chosen = (name, known) => known.includes(words.get(name)) && (scene[name] = words.get(name));
    const numbered = (name, least, most) => {
        const value = Number(words.get(name) ?? NaN);
        if (value >= least && value <= most) scene[name] = value;
    };
    chosen("rig", Object.keys(CATALOGUE.rigs));
    chosen("task", ["balance", "swing-up", "none"]);
    chosen("source", CATALOGUE.python ? ["python", "tab"] : ["tab"]);
    chosen(
        "left",
        offered(scene).map((each) => each.name),
    );
    if (words.get("right") === "") scene.right = "";
    else
        chosen(
            "right",
            offered(scene).map((each) => each.name),
        );
    numbered("copies", 1, CATALOGUE.mostCopies);
    numbered("lam", 0.05, 0.8);
    numbered("seed", 0, 1e9);
    numbered("speed", 0.05, 1);
    scene.copies = Math.round(scene.copies);
    scene.seed = Math.round(scene.seed);
    const start = (words.get("start") ?? "").split(",").map(Number);
    if (start.length === 6 && start.every((each) => Math.abs(each) < 100))
        scene.start = STARTS[placeOf(start)]?.[1] ?? start;
    for (const [name, [, , least, most]] of Object.entries(SLIDERS)) {
        const value = Number(words.get(name) ?? NaN);
        if (value >= least && value <= most) scene.changes[name] = value;
    }
    return fitted(scene);
}

/** Return the # of a scene's URL. */
export function hashOf(scene) {
    const words = new URLSearchParams();
    for (const [name, value] of Object.entries({ ...scene, ...scene.changes })) {
        if (name === "changes") continue;
        if (name === "start") {
            if (rounded(value) !== rounded(FIRST.start)) words.set(name, rounded(value));
        } else if (value !== FIRST[name]) words.set(name, value);
    }
    return `#${words}`;
}

/** Return the controllers that a scene's rig, task and source allow. */
export function offered(scene) {
    const fits = (each) =>
        each.rigs.includes(scene.rig) && (scene.task === "none" || each.tasks.includes(scene.task));
    return CATALOGUE.controllers.filter(
        (each) => fits(each) && (scene.source === "python" || worksInTab(each.name, scene.rig)),
    );
}

/** Return a scene with controllers that it allows. */
export function fitted(scene) {
    const names = offered(scene).map((each) => each.name);
    const wanted = scene.task === "swing-up" ? ["iLQR MPC", "DDPG swing-up", "pumping, LQR"] : ["Q tuned", "LQR"];
    const stand = wanted.filter((name) => names.includes(name));
    if (!names.includes(scene.left)) scene.left = stand[0] ?? names[0];
    if (scene.right && !names.includes(scene.right)) scene.right = stand.find((name) => name !== scene.left) ?? "";
    return scene;
}

/** Return the states in which every lane begins, six numbers a copy: the start, or at random for many copies. */
export function startStates(scene) {
    if (scene.copies === 1) return Float64Array.from(scene.start);
    const states = new Float64Array(6 * scene.copies),
        noise = new Noise(scene.seed, 2);
    const middle = scene.task === "swing-up" ? Math.PI : 0;
    for (let i = 0; i < scene.copies; i++) {
        for (const j of [1, 2]) states[6 * i + j] = middle + scene.lam * (2 * noise.uniform() - 1);
    }
    return states;
}

/** Return the best share of starts that any force saves at a scene's λ; NaN where it is not known. */
export function savable(scene) {
    const { saved } = CATALOGUE,
        plain = Object.keys(scene.changes).length === 0;
    if (scene.rig !== saved.rig || scene.task !== "balance" || !plain) return NaN;
    const i = saved.lambdas.findIndex((lam) => lam >= scene.lam - 1e-9);
    if (i < 0) return NaN;
    if (i === 0 || Math.abs(saved.lambdas[i] - scene.lam) < 1e-9) return saved.shares[i];
    const part = (scene.lam - saved.lambdas[i - 1]) / (saved.lambdas[i] - saved.lambdas[i - 1]);
    return saved.shares[i - 1] + part * (saved.shares[i] - saved.shares[i - 1]);
}
