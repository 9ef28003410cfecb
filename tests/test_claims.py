"""Every estimate on the pages and in the findings of the studies stands in a row of a table, and is found there."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

SOURCE = Path(__file__).parent.parent / "docs" / "claims.py"


@pytest.fixture(scope="module")
def claims() -> ModuleType:
    """Return the module, which lies beside the pages and in no package."""
    spec = importlib.util.spec_from_file_location("claims", SOURCE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_estimate_on_the_pages_rests_on_a_row(claims: ModuleType) -> None:
    found = [claim for page in claims.pages() for claim in claims.claims(page)]
    lacking = [f"{claim.page}: {each} in: {claim.words[:80]}" for claim in found for each in claim.lacking]
    assert not lacking, "These stand in no table of docs/results:\n" + "\n".join(lacking)
    assert len(found) > 30  # those in sentences: the tables of most pages are taken from docs/results
    assert all(claim.rests_on for claim in found)


def test_what_rests_on_something_else_is_named_where_it_stands(claims: ModuleType) -> None:
    for page, start in claims.ELSEWHERE:
        titles = [block.title for block in claims.blocks((claims.ROOT / page).read_text())]
        assert any(title.startswith(start) for title in titles), f"Nothing on {page} begins with {start!r}"


@pytest.fixture
def page(claims: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Path]:
    """Return a page beside one table."""
    (tmp_path / "docs/results/mine").mkdir(parents=True)
    (tmp_path / "docs/results/mine/tables.md").write_text(
        "## Saved, %\n\n| who | n | λ = 0.3 | fall |\n| --- | --- | --- | --- |\n"
        "| LQR | 100 | 87.34 [80.12, 91.96] | \\> 0.6 [0.598, \\> 0.6] |\n"
        "| SDRE | 100 | -3.3 [-3.9, -2.8] | 1,020 [900, 1,100] |\n"
    )
    monkeypatch.setattr(claims, "ROOT", tmp_path)
    claims._rows.cache_clear()
    yield tmp_path / "docs/page.md"
    claims._rows.cache_clear()


@pytest.mark.parametrize(
    ("said", "rests_on", "lacking"),
    [
        ("LQR saves 87.3 % [80.1, 92.0].", ("mine, Saved, %: LQR",), ()),
        ("It saves 87 [80, 92] %, and falls at > 0.6 [0.598, > 0.6] rad", ("mine, Saved, %: LQR",), ()),
        ("- one\n- LQR saves 87.4 % [80.1, 92.0]", (), ("87.4 % [80.1, 92.0]",)),
        ("LQR saves 87.3 % [80.2, 92.0]", (), ("87.3 % [80.2, 92.0]",)),
        ("| a | b |\n|---|---|\n| SDRE | −3.3 [−3.9, −2.8] | 1020 [900, 1100] |", ("mine, Saved, %: SDRE",), ()),
        ("| a | b |\n|---|---|\n| SDRE | +3.3 [−3.9, −2.8] |", (), ("+3.3 [−3.9, −2.8]",)),
    ],
)
def test_an_estimate_is_found_by_all_three_numbers_as_the_page_rounds_them(
    claims: ModuleType, page: Path, said: str, rests_on: tuple[str, ...], lacking: tuple[str, ...]
) -> None:
    page.write_text(said)
    (claim,) = claims.claims(page)
    assert (claim.rests_on, claim.lacking) == (rests_on, lacking)


def test_links_and_lists_of_numbers_are_no_estimates(claims: ModuleType, page: Path) -> None:
    page.write_text("Table 2 [1, 2](link) and Q = 3 [a, b] and between 1 and [2, 3].\n```\n5 [4, 6]\n```\n")
    assert not list(claims.claims(page))
