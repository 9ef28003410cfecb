"""The playground: its loop is the stepper's, its figures are ours, and its server lets nobody in or down."""

from __future__ import annotations

import asyncio
import http.client
import json
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import foreign
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image, ImageSequence
from rigs import random_params, whole

import dpend
from controllers import LQR
from dpend.metrics import force_metrics
from dpend.rig import Rig
from studies._boundary import kept_boundary
from studies._field import CONTENDERS, Contender
from studies.playground import export, scene
from studies.playground.__main__ import main
from studies.playground.scene import Playground, Scene, parsed

RIG = dpend.rig("gustafsson2016")
START = [0.0, 0.1, -0.05, 0.0, 0.0, 0.0]

# ------------------------------------------------------------------------------------------------------- in JavaScript


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the page's modules, of the laws LQR alone."""
    folder = tmp_path_factory.mktemp("page")
    code = export._law(CONTENDERS[0], "gustafsson2016")
    laws = "".join(f"LAWS[{name!r}] = {{ LQR: {code} }};\n" for name in dpend.rigs())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(export, "_laws", lambda: f"export const LAWS = {{}};\n{laws}")
        for name, text in export.files().items():
            (folder / name).write_text(text, encoding="utf-8")
    (folder / "package.json").write_text('{"type": "module"}')
    return folder


def run(page: Path, source: str, *given: object) -> Any:
    """Return what a program says, as JSON, that was given some values."""
    listed = json.dumps(given, allow_nan=False)
    program = f"const given = {listed};\n{source}\n"
    return json.loads(foreign.output(foreign.script(page, program)))


STEPPING = """
import { changedRig, Stepper } from "./physics.js";
console.log(JSON.stringify(given.map(({ rig, x0, commands, pushes }) => {
    const stepper = new Stepper(changedRig(rig, {}), 0), seen = [Array.from(stepper.reset(x0))];
    commands.forEach((u, k) => {
        const y = stepper.step(u, pushes[k]);
        seen.push([...y, ...stepper.x, stepper.force]);
    });
    return { substeps: stepper.substeps, seen };
})));
"""


def test_the_loop_in_the_tab_is_that_of_the_stepper_with_delays_lag_limit_and_stiff_friction(page: Path) -> None:
    rng = np.random.default_rng(0)
    cases, expected = [], []
    for k in range(12):
        params = random_params(rng)
        rig = Rig(params=params, sample_time=0.02, force_limit=20.0, actuator_delay=k % 3, sensor_delay=k % 4,
                  actuator_lag=0.03 * (k % 2)).replace(joint2_friction=[0.0, 0.5, 40.0][k % 3])  # fmt: skip
        x0 = rng.normal(size=6)
        commands, pushes = rng.normal(scale=20, size=20), rng.normal(scale=3, size=(20, 3))
        cases.append({"rig": export.plain_rig(rig), "x0": x0.tolist(), "commands": commands.tolist(),
                      "pushes": pushes.tolist()})  # fmt: skip
        stepper = dpend.Stepper(rig, 1)
        seen = [stepper.reset(x0)[0]]
        for u, push in zip(commands, pushes, strict=True):
            y = stepper.step([u], push)
            seen.append(np.concatenate([y[0], stepper.x[0], stepper.force]))
        expected.append((rig.substeps, seen))
    assert len({substeps for substeps, _ in expected}) > 1
    for found, (substeps, seen) in zip(run(page, STEPPING, *cases), expected, strict=True):
        assert found["substeps"] == substeps
        for here, there in zip(found["seen"], seen, strict=True):
            assert_allclose(here, there, rtol=1e-8, atol=1e-8)


def test_noise_in_the_tab_is_normal_and_the_same_for_both_pendulums(page: Path) -> None:
    numbers = run(
        page,
        """
        import { Noise } from "./physics.js";
        const streams = [[1, 0], [1, 0], [2, 0], [1, 1]].map(([seed, stream]) => new Noise(seed, stream));
        console.log(JSON.stringify(streams.map((noise) => Array.from({ length: 20000 }, () => noise.normal()))));
        """,
    )
    one, again, other, stream = np.array(numbers)
    assert_array_equal(one, again)
    assert abs(one.mean()) < 0.03
    assert one.std() == pytest.approx(1, abs=0.03)
    assert (np.abs(one) > 1.959964).mean() == pytest.approx(0.05, abs=0.006)
    assert abs(np.corrcoef([one, other, stream]) - np.eye(3)).max() < 0.03


LANE = """
import { writeFileSync } from "node:fs";
import { CATALOGUE } from "./catalogue.js";
import { LaneRecord } from "./lane.js";
import { csvOf } from "./record.js";
import { TabSource } from "./tab.js";
const [x0, push] = given, rig = CATALOGUE.rigs.gustafsson2016, source = new TabSource();
const message = {
    rig: "gustafsson2016", task: "balance", changes: {}, controllers: ["LQR"], seed: 0, k: 0, states: [x0],
};
const lane = new LaneRecord({ name: "LQR" }, Float64Array.from(x0), rig);
await source.scene(message);
for (let k = 0; k < 60; k++) {
    const now = k < 20 ? push : [0, 0, 0], said = await source.advance(5, now);
    lane.extend(said.lanes[0], 5, now);
}
writeFileSync(new URL("run.csv", import.meta.url), csvOf(lane));
console.log(JSON.stringify({ figures: lane.figures(), x: lane.x, u: lane.u }));
"""


def test_a_run_in_the_tab_is_that_of_simulate_and_its_table_reads_back_equal(page: Path) -> None:
    pushed = [3.0, -0.5, 0.2]
    found = run(page, LANE, START, pushed)
    expected = dpend.simulate(RIG, LQR(RIG), START, push=lambda t: pushed if t < 2 - 1e-9 else [0, 0, 0])
    assert_allclose(found["x"], expected.x, rtol=0, atol=1e-9)
    assert_allclose(found["u"], expected.u, rtol=0, atol=1e-7)
    read = dpend.Run.from_csv(page / "run.csv", RIG)
    assert_array_equal(read.x, found["x"])
    assert_array_equal(read.u, found["u"])
    figures = found["figures"]
    for name, value in force_metrics(read.u[None], RIG.sample_time, 40.0).items():
        if name != "peak_force":
            assert figures[name] == pytest.approx(value[0], rel=1e-12), name


def test_two_pendulums_in_the_tab_get_the_same_noise(page: Path) -> None:
    source = LANE.partition("const lane =")[0].replace('changes: {}, controllers: ["LQR"]', "changes, controllers")
    source = source.replace("[x0, push] = given", "[x0, changes, controllers] = given").replace("[x0],", "[x0, x0],")
    source += """
    await source.scene(message);
    console.log(JSON.stringify((await source.advance(50, [0, 0, 0])).lanes.map(({ x, u }) => ({ x, u }))));
    """
    noisy = {"sensor_noise": 0.01, "force_noise": 2.0, "sensor_delay": 1}
    left, right = run(page, source, START, noisy, ["LQR", "LQR"])
    assert left == right
    assert left != run(page, source, START, {}, ["LQR", "LQR"])[0]


def test_a_run_that_falls_in_the_tab_ends_at_the_same_sample_for_the_same_reason(page: Path) -> None:
    x0 = [0.0, 0.7, -0.7, 0.0, 0.0, 0.0]
    found = run(page, LANE.replace("figures: lane.figures()", "codes: lane.codes"), x0, [0.0, 0.0, 0.0])
    expected = dpend.simulate(RIG, LQR(RIG), x0)
    assert found["codes"] == [expected.status.code] != [0]
    assert len(found["x"]) == len(expected.t)


def test_a_scene_is_its_address_and_nonsense_in_it_is_left_out(page: Path) -> None:
    source = """
    globalThis.location = { hash: "" };
    const { hashOf, sceneOf, savable, startStates } = await import("./scene.js");
    const scenes = given.map((hash) => sceneOf(hash));
    console.log(JSON.stringify({
        scenes, hashes: scenes.map(hashOf), again: scenes.map((scene) => sceneOf(hashOf(scene))),
        savable: scenes.map((scene) => savable(scene)), states: Array.from(startStates(scenes[2])),
    }));
    """
    found = run(
        page,
        source,
        "",
        "#rig=pilco2011&left=iLQR+MPC&right=&start=0,3.1416,3.1416,0,0,0&mass1=0.7&seed=3",
        "#copies=300&lam=0.355",
        "#rig=../etc&left=__proto__&start=1,2&lam=NaN&copies=1e9&mass1=-4&task=constructor&speed=0",
    )
    first, second, race, nonsense = found["scenes"]
    assert found["hashes"][0] == found["hashes"][3] == "#"
    assert nonsense == first
    assert (first["left"], first["right"]) == ("Q tuned", "LQR")
    assert (second["left"], second["right"], second["changes"]) == ("iLQR MPC", "", {"mass1": 0.7})
    assert second["start"][1] == math.pi
    assert found["again"] == found["scenes"]
    assert found["savable"][1] is None
    assert found["savable"][2] == pytest.approx(kept_boundary().share(0.355).value, abs=2e-4)
    angles = np.array(found["states"]).reshape(-1, 6)[:, 1:3]
    assert angles.shape == (300, 2)
    assert 0.33 < np.abs(angles).max() <= 0.355
    assert abs(angles.mean()) < 0.03
    assert race["copies"] == 300


def test_the_gif_shows_the_pictures_that_it_was_given(page: Path) -> None:
    rng = np.random.default_rng(0)
    palette = 8 * rng.integers(0, 32, (200, 3)) + 4
    pictures = palette[rng.integers(0, 200, (3, 60, 90))]
    pixels = np.concatenate([pictures, np.full((*pictures.shape[:3], 1), 255)], axis=3)
    run(
        page,
        """
        import { writeFileSync } from "node:fs";
        import { gifOf } from "./gif.js";
        const film = gifOf(given.map((each) => Uint8Array.from(each)), 90, 60, 8);
        writeFileSync(new URL("film.gif", import.meta.url), film);
        console.log("null");
        """,
        *(each.ravel().tolist() for each in pixels),
    )
    with Image.open(page / "film.gif") as film:
        assert film.info["duration"] == 80
        shown = [np.array(frame.convert("RGB")) for frame in ImageSequence.Iterator(film)]
    assert_array_equal(shown, pictures)


def test_the_exported_page_is_one_file_that_names_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(export, "_laws", lambda: "export const LAWS = {};\n")
    text = export.export(tmp_path / "site").read_text(encoding="utf-8")
    assert [file.name for file in (tmp_path / "site").iterdir()] == ["index.html"]
    assert not any(word in text for word in ("\nimport ", "\nexport ", "http://", "https://", ' src="', "stylesheet"))
    assert "default-src 'none'" in text


# ------------------------------------------------------------------------------------------------------------ in Python


class Failing:
    """Raises after ten samples."""

    batched = False

    def start(self, n: int, rng: np.random.Generator) -> Any:
        def act(t: float, y: Any) -> Any:
            if t > 0.19:
                raise RuntimeError("out of ideas")
            return np.zeros(n)

        return act


class Hanging:
    """Hangs after ten samples, whatever is raised."""

    def start(self, n: int, rng: np.random.Generator) -> Any:
        def act(t: float, y: Any) -> Any:
            while t > 0.19:
                try:
                    time.sleep(0.01)
                except Exception:
                    continue
            return np.zeros(n)

        return act


class Blinking:
    """Returns NaN at every third sample."""

    def start(self, n: int, rng: np.random.Generator) -> Any:
        act = LQR(RIG).start(n, rng)
        return lambda t, y: np.where(round(t / 0.02) % 3 == 1, np.nan, act(t, y))


KNOWN = [
    *CONTENDERS,
    Contender(name="failing", make=lambda rig, task: Failing()),
    Contender(name="blinking", make=lambda rig, task: Blinking()),
    Contender(name="hanging", make=lambda rig, task: Hanging()),
]


def described(*names: str, states: Any = None, **more: object) -> dict[str, Any]:
    return {"do": "scene", "rig": "gustafsson2016", "task": "none", "controllers": list(names),
            "states": [START] * len(names) if states is None else states} | more  # fmt: skip


def test_the_playground_moves_as_simulate_does_and_both_lanes_get_one_push_and_one_noise() -> None:
    noisy = {"sensor_noise": 0.01, "force_noise": 1.0, "mass1": 0.6, "actuator_delay": 1}
    playground = Playground(KNOWN)
    playground.answer(described("LQR", "LQR", changes=noisy, seed=3))
    push = [2.0, 0.1, -0.1]
    frames = [playground.answer({"do": "advance", "n": 10, "push": push}) for _ in range(5)]
    assert all(left == {**right, "ms": left["ms"]} for left, right in (frame["lanes"] for frame in frames))
    run = dpend.simulate(RIG.replace(**noisy), LQR(RIG), START, 1.0, task=None, push=lambda t: push, seed=3)
    assert_array_equal(np.concatenate([frame["lanes"][0]["x"] for frame in frames]), run.x[1:])
    assert_array_equal(np.concatenate([frame["lanes"][0]["u"] for frame in frames]), run.u)


def test_a_force_that_is_no_number_is_the_last_one_that_was() -> None:
    playground = Playground(KNOWN)
    playground.answer(described("blinking"))
    (lane,) = playground.answer({"do": "advance", "n": 50})["lanes"]
    assert_array_equal(lane["u"], dpend.simulate(RIG, Blinking(), START, 1.0, task=None).u)


def test_a_race_counts_as_the_batch_does() -> None:
    starts = dpend.Balance(lam=0.5).starts(np.random.default_rng(0), 40, RIG)
    playground = Playground(KNOWN)
    playground.answer(described("LQR", "sign of LQR", states=[starts.ravel().tolist()] * 2, task="balance"))
    frame = [playground.answer({"do": "advance", "n": 50}) for _ in range(6)][-1]
    runs = dpend.simulate_many(RIG, LQR(RIG), starts)
    assert frame["lanes"][0]["codes"] == runs.codes.tolist()
    assert 0 < np.count_nonzero(runs.codes) < 40
    assert_allclose(np.reshape(frame["lanes"][0]["states"], (40, 6)), runs.final, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("failing", "failing failed: RuntimeError: out of ideas"),
        ("hanging", "hanging took longer than 0.2 s for one sample and was stopped."),
    ],
)
def test_a_controller_that_fails_or_hangs_is_reported_and_the_other_goes_on(
    name: str, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene, "_NEXT", 0.2)
    playground = Playground(KNOWN)
    playground.answer(described(name, "LQR"))
    left, right = playground.answer({"do": "advance", "n": 20})["lanes"]
    assert left["failed"] == why
    assert left["codes"] == [dpend.Status.CONTROLLER_FAILED.code]
    assert (len(left["u"]), len(right["u"])) == (10, 20)
    assert right["codes"] == [0]
    assert playground.answer({"do": "advance"})["lanes"][1]["codes"] == [0]


def test_a_change_while_it_runs_keeps_states_and_what_a_controller_remembers() -> None:
    playground = Playground(KNOWN)
    hanging = dpend.EQUILIBRIA["down-down"].tolist()
    swinging = described("TVLQR", "DDPG swing-up", states=[hanging] * 2, task="swing-up")
    playground.answer(swinging)
    before = playground.answer({"do": "advance", "n": 30})["lanes"]
    laws = [lane.act for lane in playground._lanes]
    changed = swinging | {"k": 30, "states": [lane["states"] for lane in before], "changes": {"mass2": 0.51}}
    assert [lane["states"] for lane in playground.answer(changed)["lanes"]] == changed["states"]
    assert [lane.act for lane in playground._lanes] == laws
    exchanged = changed | {"controllers": ["LQR", "DDPG swing-up"], "task": "none"}
    playground.answer(exchanged)
    assert all(new.act is not old for new, old in zip(playground._lanes, laws, strict=True))


BAD: list[tuple[dict[str, Any], str]] = [
    ({"do": "run"}, 'do must be "scene" or "advance"; got \'run\'.'),
    ({"do": "advance"}, "There is no scene yet: describe one first."),
    ({"do": "advance", "n": 1e300}, "n must be a number from 0 to 50; got 1e+300."),
    ({"do": "advance", "n": 1.5}, "n must be a whole number from 0 to 50; got 1.5."),
    ({"do": "advance", "push": [1e9, 0, 0]}, "push must be a number from -1000 to 1000; got 1000000000.0."),
    ({"do": "advance", "push": [True, 0, 0]}, "push must be a number from -1000 to 1000; got True."),
    ({"do": "advance", "push": ""}, "push must be a list of a force on the cart, N, and torques on both links, N m."),
    (described("LQR", states=[[0.0] * 5]), "states must be lists of six numbers for each of 1 to 500 copies."),
    (described("LQR", states=[[0.0] * 6006]), "states must be lists of six numbers for each of 1 to 500 copies."),
    (described("LQR", states=[["0"] * 6]), "states must be lists of numbers."),
    (described("LQR", states=[[10**400] * 6]), "states must be lists of numbers that fit into 64 bits."),
    (described("LQR", states=[[1e9] * 6]), "states must be within 1e+06 m, rad, m/s and rad/s."),
    (described("LQR", states={}), "states must be a list with one list of numbers for each controller."),
    (described("LQR", "LQR", "LQR"), "controllers must be a list of one name or two."),
    (described("LQR", k=-1), "k must be a number from 0 to 1e+09; got -1."),
    (described("LQR", changes={"mass1": 0}), "mass1 must be finite and greater than 0 kg; got 0."),
    (described("LQR", changes={"sensor_delay": 51}), "sensor_delay must be a number from 0 to 50; got 51."),
    (described("LQR", changes=[1]), "changes must be an object of numbers by name."),
]  # fmt: skip


@pytest.mark.parametrize(("message", "why"), BAD, ids=range(len(BAD)))
def test_what_the_page_would_never_say_is_refused(message: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError, match=whole(why)):
        Playground(KNOWN).answer(message)


def test_only_names_that_are_known_stand_for_anything() -> None:
    for changed in ({"rig": "/etc/passwd"}, {"rig": "mine.toml"}, {"task": "__class__"}, {"changes": {"params": 1}},
                    {"controllers": ["os:system"]}, {"controllers": [["LQR"]]}):  # fmt: skip
        with pytest.raises(ValueError, match=r"must be "):
            Scene.of(described("LQR") | changed, KNOWN)


@pytest.mark.parametrize("text", ["", "[1]", '{"n": NaN}', '{"n": -Infinity}', "1" * 5000, "[" * 100_000, '"a', "\x00"])
def test_what_is_no_json_object_of_finite_numbers_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"^A message is a JSON object"):
        parsed(text)


NUMBERS = st.integers() | st.floats() | st.sampled_from([10**400, 1e308, -1e308, 5e-324, True])
ANYTHING = st.recursive(
    st.none() | NUMBERS | st.text(max_size=8) | st.sampled_from(["LQR", "down-down", "../etc/passwd", "__class__"]),
    lambda inner: st.lists(inner, max_size=7) | st.dictionaries(st.sampled_from(scene.CHANGES), inner, max_size=3),
    max_leaves=14,
)
KEYS = ("do", "rig", "task", "changes", "controllers", "states", "k", "seed", "n", "push", "more")


@pytest.mark.slow
@settings(deadline=None, max_examples=100)
@given(key=st.sampled_from(KEYS), value=ANYTHING, moved=st.booleans())
def test_whatever_stands_in_a_message_it_is_answered_or_refused_in_words(key: str, value: Any, moved: bool) -> None:
    playground = Playground(KNOWN)
    playground.answer(described("LQR"))
    message = ({"do": "advance", "n": 1} if moved else described("LQR")) | {key: value}
    try:
        answer = playground.answer(parsed(json.dumps(message)))
    except ValueError as error:
        answer = {"error": str(error)}
    assert json.loads(json.dumps(answer, allow_nan=False))
    assert playground.answer({"do": "advance", "n": 3})["lanes"]  # and it goes on


def test_the_command_writes_the_page_or_says_what_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(export, "_laws", lambda: "export const LAWS = {};\n")
    main(["--export", str(tmp_path)])
    assert capsys.readouterr().out == f"{tmp_path / 'index.html'}\n"
    with pytest.raises(SystemExit, match=r"^2$"):
        main(["--controller", "mine", "--no-browser"])
    assert capsys.readouterr().err == "--controller must be path.py:factory or module:factory; got 'mine'.\n"


# ----------------------------------------------------------------------------------------------------------- the server

CHATTY = """
import os
import dpend


class Chatty:
    def __init__(self, rig: dpend.Rig) -> None:
        self.limit = rig.force_limit

    def start(self, n, rng):
        def act(t, y):
            print("to the terminal")
            os.write(1, b"and past Python")
            return [self.limit] * n

        return act
"""


@pytest.mark.slow
def test_a_process_answers_for_the_users_own_controller_whatever_that_prints(tmp_path: Path) -> None:
    server = pytest.importorskip("studies.playground.server", reason="the server needs the extra web")
    (tmp_path / "mine.py").write_text(CHATTY)

    async def answers() -> list[Any]:
        process = server.Process([f"{tmp_path / 'mine.py'}:Chatty"])
        await process.start()
        try:
            messages = [described("Chatty", "LQR"), {"do": "advance", "n": 2}, {"do": "advance", "n": 99}]
            return [json.loads(await process.ask(message)) for message in messages]
        finally:
            await process.end()

    _, moved, refused = asyncio.run(answers())
    assert moved["lanes"][0]["u"] == [40.0, 40.0]
    assert refused == {"error": "n must be a number from 0 to 50; got 99."}


websockets = pytest.importorskip("websockets.sync.client", reason="the server needs the extra web")
ECHO = """
import json, sys, time
print('{"ready": true}', flush=True)
for line in sys.stdin:
    message = json.loads(line)
    if message.get("n") == 49: time.sleep(60)
    if message.get("n") == 48: sys.exit()
    print(json.dumps({"said": message}), flush=True)
"""


@pytest.fixture(scope="module")
def patched() -> Iterator[pytest.MonkeyPatch]:
    with pytest.MonkeyPatch.context() as patch:
        yield patch


@pytest.fixture(scope="module")
def serve(patched: pytest.MonkeyPatch) -> Iterator[Callable[..., Any]]:
    """Return a function that starts a server whose processes only repeat what they are told."""
    from studies.playground import server

    patched.setattr(server, "files", lambda specs: {"index.html": "page", "main.js": "code"})
    patched.setattr(server, "_FIRST_ANSWER", 1.0)
    patched.setattr(server, "_NEXT_ANSWER", 1.0)
    patched.setattr(server.Process, "command", property(lambda self: (sys.executable, "-c", ECHO)))
    running = []

    def start(host: str = "127.0.0.1") -> Any:
        built = server.Server(host=host)
        serving = built.serving()
        thread = threading.Thread(target=serving.run, kwargs={"sockets": [built.listener]})
        thread.start()
        running.append((serving, thread))
        while not serving.started:
            time.sleep(0.01)
        return built

    yield start
    for serving, thread in running:
        serving.should_exit = True
        thread.join()


@pytest.fixture(scope="module")
def local(serve: Callable[..., Any]) -> Any:
    return serve()


def fetched(server: Any, path: str, **headers: str) -> tuple[int, str]:
    """Return status and text of an answer to a request as it stands, not tidied up."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    connection.putrequest("GET", path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    said = answer.status, answer.read().decode()
    connection.close()
    return said


def connected(server: Any, query: str = "", **headers: str) -> Any:
    return websockets.connect(
        f"ws://127.0.0.1:{server.port}/socket{query}", additional_headers=headers, max_size=None, proxy=None
    )


def asked(socket: Any, message: Any) -> Any:
    socket.send(message if isinstance(message, str | bytes) else json.dumps(message))
    return json.loads(socket.recv(timeout=10))


HANDSHAKE = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
             "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA=="}  # fmt: skip


def test_pages_of_other_hosts_and_other_names_of_this_one_are_refused(local: Any) -> None:
    at = f"127.0.0.1:{local.port}"
    own = {"Host": f"localhost:{local.port}", "Origin": f"http://localhost:{local.port}"}
    assert fetched(local, "/") == (200, "page")
    assert fetched(local, "/", **own)[0] == 200
    with connected(local, Origin=f"http://{at}") as socket:
        assert "said" in asked(socket, {"do": "advance"})
    for headers in ({"Host": f"evil.example:{local.port}"}, {"Host": "127.0.0.1:1"}, {"Host": ""},
                    {"Origin": "http://evil.example"}, {"Origin": "null"}, {"Origin": f"https://{at}"}):  # fmt: skip
        assert fetched(local, "/main.js", **headers)[0] == 403
        assert fetched(local, "/socket", **HANDSHAKE, **headers)[0] == 403


@pytest.mark.parametrize("path", ["/../server.py", "/..%2f..%2fpyproject.toml", "//etc/passwd", "/main.js/", "/socket"])
def test_no_path_reaches_a_file(local: Any, path: str) -> None:
    assert fetched(local, path) == (404, "There is no such page.")


@pytest.mark.slow
def test_no_message_stops_the_server_or_another_visitor(local: Any) -> None:
    from websockets.exceptions import ConnectionClosed

    with connected(local) as one, connected(local) as other:
        assert asked(other, {"id": 7, "do": "advance", "n": 1}) == {"id": 7, "said": {"do": "advance", "n": 1}}
        for nonsense in (
            "",
            "[]",
            '{"do": 1}',
            '{"do": "exec"}',
            '{"id": {}, "do": "scene"}',
            '{"n": NaN}',
            b"\x00\xff",
        ):
            assert "error" in asked(one, nonsense)
        one.send(json.dumps({"do": "advance", "n": 49}))  # hangs
        assert asked(other, {"id": 8, "do": "advance", "n": 1})["id"] == 8
        assert json.loads(one.recv(timeout=10))["lost"] == "The controllers did not answer and were stopped."
        assert "lost" in asked(one, {"do": "advance", "n": 48})  # dies
        assert asked(one, {"id": 9, "do": "advance", "n": 1})["id"] == 9  # in a new process
        with pytest.raises(ConnectionClosed):
            asked(one, "x" * 10_000_000)
        assert asked(other, {"id": 10, "do": "advance", "n": 1})["id"] == 10
    assert fetched(local, "/")[0] == 200


def answered(socket: Any) -> bool:
    from websockets.exceptions import ConnectionClosed

    try:
        return "said" in asked(socket, {"do": "advance", "n": 1})
    except ConnectionClosed:  # refused before it could ask
        return False


@pytest.mark.slow
def test_of_two_hundred_connections_six_are_served_and_the_server_goes_on(local: Any) -> None:
    opened, served = [], 0
    for _ in range(200):
        socket = connected(local).__enter__()
        opened.append(socket)
        served += answered(socket)
    assert served == 6
    assert answered(opened[0])
    for socket in opened:
        socket.close()
    deadline = time.monotonic() + 5
    while time.monotonic() < deadline:  # a place becomes free
        with connected(local) as socket:
            if answered(socket):
                return
    raise AssertionError("no place became free")


def test_beyond_this_machine_only_those_who_know_the_token_are_served(serve: Callable[..., Any]) -> None:
    from websockets.exceptions import InvalidStatus

    server = serve("0.0.0.0")
    token = server.url.partition("?token=")[2]
    assert len(token) > 20
    assert fetched(server, "/", Host="machine.example")[0] == 403
    assert fetched(server, f"/?token={token}", Host="machine.example")[0] == 200
    assert fetched(server, f"/?token={token[:-1]}", Host="machine.example")[0] == 403
    for query in ("", "?token=", f"?token={token[:-1]}"):
        with pytest.raises(InvalidStatus, match=r"HTTP 403$"), connected(server, query):
            pass
    with connected(server, f"?token={token}") as socket:
        assert "said" in asked(socket, {"do": "advance", "n": 1})


def test_nothing_listens_beyond_this_machine_unless_asked(local: Any) -> None:
    assert local.listener.getsockname()[0] == "127.0.0.1"
    assert local.url == f"http://127.0.0.1:{local.port}/"
