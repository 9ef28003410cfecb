"""The table of comparisons: what is kept of it, and how it is written for people."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

COLUMNS = ("part", "quantity", "engine", "cases", "unanswered", "median", "worst", "tolerance", "version")


def read(file: Path) -> pd.DataFrame:
    """Return the kept lines; versions stay words."""
    return pd.read_csv(file, dtype={"version": str})


def markdown(rows: pd.DataFrame) -> str:
    """Return the lines as a table in Markdown."""
    lines = ["| quantity | beside | cases | no answer | median error | worst error |", "|---|---|---:|---:|---:|---:|"]
    for row in rows.to_dict("records"):
        counts = f"{row['cases']:,} | {row['unanswered'] or ''}"
        errors = f"{row['median']:.1e} | {row['worst']:.1e}"
        lines.append(f"| {row['quantity']} | {row['engine']} ({row['version']}) | {counts} | {errors} |")
    return "\n".join(lines)
