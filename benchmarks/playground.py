# pyright: reportMissingImports=false
"""How fast the page of pendulums draws, and how soon it shows a push, in headless Chromium (``web``, ``web-test``).

``python -m benchmarks.playground`` prints pictures a second of a blank page that asks for nothing but its next picture,
of two pendulums from Python, one of them under iLQR MPC, and of races in the tab; and the time from a key to the first
picture that shows what the push did.
"""

from __future__ import annotations

import shutil
import statistics
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from playwright.sync_api import sync_playwright
from rich.console import Console
from rich.table import Table

from studies.playground.export import export
from studies.playground.server import Server

SECONDS, PUSHES = 10.0, 20
_FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
          "--disable-component-update", "--disable-sync")  # fmt: skip
_BLANK = """
async (ms) => {
    const began = performance.now();
    let n = 0;
    for (let now = began; now < began + ms; n++) now = await new Promise(requestAnimationFrame);
    return (1000 * n) / (performance.now() - began);
}
"""
_FRAMES = """
async (ms) => {
    const began = performance.now(), from = { frames: playground.frames, k: playground.k };
    await new Promise((resolve) => setTimeout(resolve, ms));
    const seconds = (performance.now() - began) / 1000, h = playground.rig.sample_time;
    return [(playground.frames - from.frames) / seconds, ((playground.k - from.k) * h) / seconds];
}
"""
# A picture shows a push once it is later than the sample over which the push was held first.
_PUSHED = """
async (sign) => {
    const key = (type) => dispatchEvent(new KeyboardEvent(type, { key: sign > 0 ? "ArrowRight" : "ArrowLeft" }));
    const lane = playground.lanes[0], first = lane.u.length, began = performance.now();
    document.getElementById("stage").dispatchEvent(
        new KeyboardEvent("keydown", { key: sign > 0 ? "ArrowRight" : "ArrowLeft", bubbles: true }));
    for (;;) {
        await new Promise(requestAnimationFrame);
        const k = lane.pushes.findIndex((push, k) => k >= first && push[0] !== 0);
        if (k >= 0 && playground.lastShown > k * lane.rig.sample_time) break;
    }
    const ms = performance.now() - began;
    key("keyup");
    await new Promise((resolve) => setTimeout(resolve, 300));
    return ms;
}
"""


@contextmanager
def served() -> Iterator[str]:
    """Serve the page, and return its address."""
    server = Server()
    serving = server.serving()
    thread = threading.Thread(target=serving.run, kwargs={"sockets": [server.listener]})
    thread.start()
    try:
        yield server.url
    finally:
        serving.should_exit = True
        thread.join()


def main() -> None:
    """Measure, and print the tables."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    table = Table("", "pictures/s", "× real time", "key to picture, ms, median (longest)")
    with tempfile.TemporaryDirectory() as folder, served() as server, sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium, args=_FLAGS)
        in_tab = export(folder).as_uri()
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.goto("about:blank")
        table.add_row("a blank page", f"{page.evaluate(_BLANK, 1000 * SECONDS):.0f}", "", "")
        page.close()
        for name, address, pushed in (
            ("two pendulums, iLQR MPC and LQR, in Python", f"{server}#left=iLQR+MPC", True),
            ("two pendulums, Q tuned and LQR, in the tab", f"{in_tab}#", True),
            ("a race of 2 × 100, Q tuned and LQR, in the tab", f"{in_tab}#copies=100&lam=0.2", False),
            ("a race of 2 × 500, Q tuned and LQR, in the tab", f"{in_tab}#copies=500&lam=0.2", False),
            ("a race of 2 × 100, iLQR MPC and LQR, in Python", f"{server}#copies=100&lam=0.2&left=iLQR+MPC", False),
        ):
            page = browser.new_page(viewport={"width": 1280, "height": 900})
            page.goto(address)
            wait(page, lambda page=page: page.evaluate("playground.k > 25"))  # compiled and warm
            frames, pace = page.evaluate(_FRAMES, 1000 * SECONDS)
            times = [page.evaluate(_PUSHED, (-1) ** k) for k in range(PUSHES)] if pushed else []
            said = f"{statistics.median(times):.0f} ({max(times):.0f})" if times else ""
            table.add_row(name, f"{frames:.0f}", f"{pace:.2f}", said)
            page.close()
        browser.close()
    Console(width=120).print(table)


def wait(page: Any, condition: Callable[[], Any]) -> None:
    """Wait until a condition holds, at most two minutes."""
    for _ in range(1200):
        if condition():
            return
        page.wait_for_timeout(100)
    raise TimeoutError("The page did not begin within two minutes.")


if __name__ == "__main__":
    main()
