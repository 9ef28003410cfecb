"""Write the page of all studies: ``python -m studies.report``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from .._closure import ROOT
from .page import write


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the page, and say where it is and how large."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.report",
        description="Write a page, one file, with what the saved tables of studies say.",
    )
    parser.add_argument("--results", type=Path, metavar="FOLDER", default=ROOT / "docs" / "results",
                        help="folder with a folder for each study's table; left out, docs/results")  # fmt: skip
    parser.add_argument("--out", type=Path, metavar="FILE", default=Path("results/report.html"),
                        help="left out, results/report.html")  # fmt: skip
    options = parser.parse_args(arguments)
    try:
        page = write(options.results, options.out)
    except (OSError, ValueError) as error:
        parser.exit(2, f"{error}\n")
    print(f"{page}, {page.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
