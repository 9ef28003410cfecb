"""The playground in a browser: from Python and in the tab alone, by mouse, finger and keys.

They take the extras ``web`` and ``web-test``, and Chromium as the system has it.
"""

from __future__ import annotations

import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

import dpend
from studies.playground.export import export

playwright = pytest.importorskip("playwright.sync_api", reason="needs the extra web-test: pip install -e '.[web-test]'")
pytest.importorskip("uvicorn", reason="needs the extra web: pip install -e '.[web]'")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync")  # fmt: skip
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium, which is not installed here"),
]
MINE = """
class Failing:
    batched = False

    def start(self, n, rng):
        def act(t, y):
            if t > 0.5:
                raise RuntimeError("out of ideas")
            return [0.0]

        return act


class Hanging:
    def start(self, n, rng):
        def act(t, y):
            while t > 0.5:
                pass
            return [0.0] * n

        return act
"""


@pytest.fixture(scope="module")
def addresses(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """Return where the page is served from Python, and where it lies as a file."""
    from studies.playground.server import Server

    folder = tmp_path_factory.mktemp("playground")
    (folder / "mine.py").write_text(MINE)
    server = Server([f"{folder / 'mine.py'}:{name}" for name in ("Failing", "Hanging")])
    serving = server.serving()
    thread = threading.Thread(target=serving.run, kwargs={"sockets": [server.listener]})
    thread.start()
    yield {"python": server.url, "tab": export(folder / "site").as_uri()}
    serving.should_exit = True
    thread.join()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as play:
        started = play.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield started
        started.close()


Open = Callable[..., Any]


@pytest.fixture
def visit(browser: Any, addresses: dict[str, str]) -> Iterator[Open]:
    """Return a function that opens a scene from a source; afterwards nothing was wrong, and no other host was asked."""
    wrong: list[str] = []
    contexts = []

    def note(request: Any) -> None:
        if not request.url.startswith((*addresses.values(), "data:", "blob:")):
            wrong.append(f"asked for {request.url}")

    def open_page(source: str, scene: str = "", **context: Any) -> Any:
        contexts.append(browser.new_context(**{"viewport": {"width": 1280, "height": 900}} | context))
        page = contexts[-1].new_page()
        page.on("console", lambda said: wrong.append(said.text) if said.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("request", note)
        page.goto(addresses[source] + "#" + scene)
        until(page, "globalThis.playground?.ready", 240)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert not wrong


SOURCES = pytest.mark.parametrize("source", ["python", "tab"])


def until(page: Any, condition: str, seconds: float = 60) -> None:
    """Wait for a condition; the page's own policy forbids it to be evaluated there."""
    deadline = time.monotonic() + seconds
    while not page.evaluate(condition):
        assert time.monotonic() < deadline, f"not within {seconds} s: {condition}"
        page.wait_for_timeout(20)


def ran(page: Any, seconds: float) -> None:
    """Wait until so many more seconds of the run are shown, however busy the machine is."""
    until(page, f"playground.clock >= {page.evaluate('playground.clock') + seconds}", 30 * seconds + 60)


SLOW, FAST = "playground.scene.speed = 0.1", "playground.scene.speed = 3"
PUSHED = "playground.lanes[0].pushes.filter((push) => push[0] !== 0).length"


@pytest.mark.parametrize(("source", "name"), [("python", "iLQR MPC"), ("tab", "DDPG swing-up")])
def test_it_swings_up(visit: Open, source: str, name: str) -> None:
    page = visit(source, f"task=swing-up&start=0,3.1416,3.1416,0,0,0&left={name.replace(' ', '+')}&right=")
    assert page.locator("#figures thead").inner_text().split("\t")[1].strip() == name
    page.evaluate(FAST)
    until(page, "playground.lanes[0].figures().up > 1", 240)
    assert page.evaluate("playground.clock") < 6
    assert page.evaluate("playground.lanes[0].x[0][1]") == pytest.approx(np.pi)


@SOURCES
def test_pushes_by_key_mouse_and_button_reach_both_pendulums_alike_and_both_recover(visit: Open, source: str) -> None:
    page = visit(source, "left=stiff+LQR&right=LQR")
    ran(page, 1.0)
    page.evaluate(SLOW)  # a busy machine then pushes no longer than another
    page.keyboard.down("ArrowRight")
    until(page, f"{PUSHED} >= 3")
    page.keyboard.up("ArrowRight")
    page.keyboard.press("2")
    page.get_by_role("button", name="Push to the left").press("Enter")
    until(page, "playground.lanes[0].pushes.some((push) => push[1] !== 0)")
    page.evaluate(FAST)
    ran(page, 3.0)
    page.evaluate(SLOW)
    box = page.locator("#stage").bounding_box()
    x, y = page.evaluate(
        "(() => { const v = playground.stage.views[1], x = v.lane.states[0]; return [v.cx + v.scale * x, v.cy]; })()"
    )
    page.mouse.move(box["x"] + x, box["y"] + y)
    page.mouse.down()
    before = page.evaluate(PUSHED)
    page.mouse.move(box["x"] + x - 60, box["y"] + y, steps=3)
    until(page, f"{PUSHED} >= {before} + 3")
    page.mouse.up()
    page.evaluate(FAST)
    ran(page, 7.0)
    left, right = map(np.array, page.evaluate("playground.lanes.map((lane) => lane.pushes)"))
    assert_array_equal(left, right)
    assert (left[:, 0] == 15).any()  # by key
    assert (left[:, 1] == -0.75).any()  # by button
    assert ((left[:, 0] < 0) & (left[:, 1] == 0)).any()  # by mouse
    assert not left[-50:].any()
    assert page.evaluate("playground.lanes.map((lane) => lane.codes[0])") == [0, 0]
    assert np.abs(page.evaluate("playground.lanes.map((lane) => lane.x.at(-1)[1])")).max() < 0.05


def test_a_finger_on_the_cart_pushes_it_and_beside_it_scrolls(visit: Open) -> None:
    page = visit("tab", viewport={"width": 390, "height": 600}, has_touch=True, is_mobile=True)
    ran(page, 0.5)
    fingers = page.context.new_cdp_session(page)
    box = page.locator("#stage").bounding_box()
    x, y = page.evaluate("[playground.stage.views[0].cx, playground.stage.views[0].cy]")

    def touch(kind: str, *at: float) -> None:
        points = [{"x": box["x"] + at[0], "y": box["y"] + at[1]}] if at else []
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    page.evaluate(SLOW)
    touch("touchStart", x, y)
    for k in range(4):
        touch("touchMove", x - 10 * k, y - 5 * k)
        page.wait_for_timeout(30)
    until(page, "Math.min(...playground.lanes[0].pushes.flat()) < -3")  # as far as the finger moved
    touch("touchEnd")
    page.evaluate(FAST)
    ran(page, 1.5)
    left, right = map(np.array, page.evaluate("playground.lanes.map((lane) => lane.pushes)"))
    assert left.min() < -3
    assert_array_equal(left, right)
    assert not left[-10:].any()
    assert page.evaluate("scrollY") == 0
    touch("touchStart", 20, 60)
    for k in range(8):
        touch("touchMove", 20, 60 - 20 * k)
        page.wait_for_timeout(16)
    touch("touchEnd")
    until(page, "scrollY > 50")


@SOURCES
def test_controller_and_plant_change_while_it_runs_and_its_table_reads_back_equal(
    visit: Open, source: str, tmp_path: Path
) -> None:
    page = visit(source)
    ran(page, 0.5)
    page.select_option("#left", "LSPI")
    until(page, "playground.lanes[0].name === 'LSPI' && playground.lanes[0].u.length > 5")
    page.locator("#mass1").fill("0.6")
    page.locator("#sensor_noise").fill("0.005")
    ran(page, 2.0)
    assert page.evaluate("playground.lanes[0].rig.params.mass1") == 0.6
    assert page.evaluate("playground.lanes.map((lane) => lane.codes[0])") == [0, 0]
    assert "mass1=0.6" in page.url
    page.get_by_role("button", name="Pause").click()
    until(page, "!playground.asking")
    with page.expect_download() as download:
        page.get_by_role("button", name="Left as CSV").click()
    download.value.save_as(tmp_path / "left.csv")
    run = dpend.Run.from_csv(tmp_path / "left.csv", "gustafsson2016")
    assert_array_equal(run.x, page.evaluate("playground.lanes[0].x"))
    assert_array_equal(run.u, page.evaluate("playground.lanes[0].u"))
    page.locator("#figures td.variation", has_text=f"{run.metrics()['variation']:.2f}").first.wait_for(timeout=5000)


@SOURCES
def test_a_scene_survives_a_reload(visit: Open, source: str) -> None:
    page = visit(source, "left=sign+of+LQR")
    page.get_by_role("button", name="Pause").click()
    page.locator("#length2").fill("1.2")
    before = page.evaluate("playground.scene")
    page.reload()
    until(page, "globalThis.playground?.ready", 240)
    assert page.evaluate("playground.scene") == before
    assert page.evaluate("playground.lanes[0].rig.params.length2") == 1.2


def test_a_dropped_connection_is_made_again_and_the_run_goes_on(visit: Open) -> None:
    page = visit("python")
    ran(page, 0.5)
    page.evaluate("playground.source.socket.close()")
    page.get_by_text("The connection to Python was lost; trying again.").wait_for()
    before = page.evaluate("playground.k")
    until(page, f"playground.k > {before} + 25")
    assert not page.locator("#notice").is_visible()
    assert page.evaluate("playground.lanes.map((lane) => lane.codes[0])") == [0, 0]


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("Failing", "Failing failed: RuntimeError: out of ideas"),
        ("Hanging", "Hanging took longer than 2 s for one sample and was stopped."),
    ],
)
def test_a_controller_that_fails_or_hangs_is_reported_and_nothing_else_stops(visit: Open, name: str, why: str) -> None:
    other = visit("python", "left=stiff+LQR")
    page = visit("python", f"left={name}")
    until(page, "playground.lanes[0].failed")
    ran(page, 1.0)
    assert why in page.locator("#status").inner_text()
    assert page.evaluate("playground.lanes[1].codes[0]") == 0
    ran(other, 1.0)
    assert other.evaluate("playground.lanes.map((lane) => lane.codes[0])") == [0, 0]


@SOURCES
def test_a_race_shows_the_share_that_stands_beside_the_best_known(visit: Open, source: str) -> None:
    page = visit(source, "copies=100&lam=0.4&left=LQR&right=")
    ran(page, 2.0)
    standing, best = page.evaluate("[playground.lanes[0].standing, 0.88713]")
    assert 0.5 < standing < best
    share = page.evaluate("playground.lanes[0].share")
    assert share == sorted(share, reverse=True)
    assert page.locator("#figures td.standing").inner_text() == f"{100 * standing:.1f}"


def test_dragging_while_it_is_paused_chooses_the_start(visit: Open) -> None:
    page = visit("tab", reduced_motion="reduce")
    assert page.evaluate("playground.running") is False  # nobody who asked for less motion is met by it
    box = page.locator("#stage").bounding_box()
    view = "(() => { const { cx, cy, scale } = playground.stage.views[0]; return [cx, cy, scale]; })()"
    cx, cy, scale = page.evaluate(view)
    page.mouse.move(box["x"] + cx + scale * 0.5 * np.sin(0.12), box["y"] + cy - scale * 0.5 * np.cos(0.12))
    page.mouse.down()
    page.mouse.move(box["x"] + cx + scale, box["y"] + cy - scale, steps=4)
    page.mouse.up()
    assert page.evaluate("playground.lanes.map((lane) => lane.states[1])") == pytest.approx([np.pi / 4] * 2, abs=0.02)
    page.get_by_role("button", name="One sample").click()
    until(page, "playground.lanes[1].u.length === 1")


def test_a_film_and_a_gif_are_handed_over(visit: Open, tmp_path: Path) -> None:
    page = visit("tab")
    for name in ("Film", "GIF"):
        page.get_by_role("button", name=name).click()
    time.sleep(1.0)
    for i, name in enumerate(("film.webm", "film.gif")):
        with page.expect_download() as download:
            page.locator(["#film", "#gif"][i]).click()
        download.value.save_as(tmp_path / name)
    assert (tmp_path / "film.webm").read_bytes()[:4] == b"\x1a\x45\xdf\xa3"
    with Image.open(tmp_path / "film.gif") as film:
        assert getattr(film, "n_frames", 1) > 3
        assert len(film.convert("RGB").getcolors(10**6) or []) > 5


CONTRAST = """
(() => {
    const style = getComputedStyle(document.documentElement);
    const light = (name) => {
        const hex = style.getPropertyValue(`--${name}`).trim().replace(/^#(.)(.)(.)$/, "#$1$1$2$2$3$3");
        const [r, g, b] = [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255)
            .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
        return 0.2126 * r + 0.7152 * g + 0.0722 * b;
    };
    const between = (...names) => {
        const [dark, bright] = names.map(light).sort((one, other) => one - other);
        return (bright + 0.05) / (dark + 0.05);
    };
    return ["ink", "soft"].flatMap((name) => ["paper", "panel"].map((ground) => between(name, ground)))
        .concat(["push", "focus"].map((name) => 1.5 * between(name, "paper")));
})()
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_can_be_read_on_a_phone_in_either_theme_and_used_by_keys_alone(visit: Open, scheme: str) -> None:
    page = visit("tab", viewport={"width": 390, "height": 800}, color_scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert min(page.evaluate(CONTRAST)) > 4.5
    reached = set()
    for _ in range(60):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("document.activeElement.id"))
        if page.evaluate("document.activeElement !== document.body"):
            assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    every = "[...document.querySelectorAll('button, select, input, canvas[tabindex]')]"
    wanted = page.evaluate(f"{every}.filter((each) => !each.disabled).map((each) => each.id)")
    assert set(wanted) <= reached
    named = "(e) => e.labels?.length || e.textContent.trim() || e.ariaLabel"
    assert page.evaluate(f"[...document.querySelectorAll('button, select, input')].every({named})")


@pytest.fixture(scope="module")
def axe(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the source of axe-core, which finds accessibility violations, from npm."""
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("axe-core comes from npm, which is not installed here")
    folder = tmp_path_factory.mktemp("axe")
    command = [npm, "install", "--ignore-scripts", "--no-audit", "--prefix", str(folder), "axe-core@4"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"npm could not fetch axe-core: {done.stderr.strip()[-200:]}")
    return (folder / "node_modules" / "axe-core" / "axe.min.js").read_text(encoding="utf-8")


VIOLATIONS = """
axe.run().then(({ violations }) => violations.filter(({ impact }) => ["serious", "critical"].includes(impact)).map(
    ({ id, nodes }) => `${id}: ${nodes.map(({ html }) => html.slice(0, 80)).join(" ")}`))
"""


@pytest.mark.parametrize(
    ("source", "scheme", "width"),
    [("python", "light", 1280), ("python", "dark", 390), ("tab", "light", 390), ("tab", "dark", 1280)],
)
def test_axe_finds_no_serious_fault(visit: Open, axe: str, source: str, scheme: str, width: int) -> None:
    page = visit(source, viewport={"width": width, "height": 900}, color_scheme=scheme)
    ran(page, 0.5)
    page.evaluate(axe)
    assert page.evaluate(VIOLATIONS) == []
    page.evaluate("document.getElementById('push-left').removeAttribute('aria-label')")
    page.evaluate("document.getElementById('push-left').textContent = ''")
    assert [violation.partition(":")[0] for violation in page.evaluate(VIOLATIONS)] == ["button-name"]
