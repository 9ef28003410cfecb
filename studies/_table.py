"""The table of a study: a data frame with arrays beside it, kept as ``rows.csv``, ``arrays.npz`` and ``meta.json``."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pandas as pd

from dpend import Rig
from dpend.archive import atomic

from ._plant import Plant, rig_of

AnyArray = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class Table:
    """What a study found."""

    rows: pd.DataFrame  # The number of each row's job, the job's plain fields, and what the job returned.
    quick: bool = False  # Whether it comes from a quick run, whose sizes are too small to mean much.
    by_job: Mapping[int, Mapping[str, AnyArray]] = field(default_factory=dict)
    """Arrays by number of their job and by name."""
    plant: Plant | None = None  # Of which plant it is, where that is not the one of the comparisons.

    @property
    def rig(self) -> Rig:
        """The rig of which it is."""
        return rig_of(self.plant)

    def where(self, **fields: Any) -> pd.DataFrame:
        """Return the rows in which columns have given values; a KeyError if there is no such column."""
        return where(self.rows, **fields)

    def lines(self, **fields: Any) -> Iterable[Any]:
        """Return the rows in which columns have given values one by one, with an attribute for each column."""
        return self.where(**fields).itertuples(index=False, name="Line")

    def arrays(self, name: str, /, **fields: Any) -> list[AnyArray]:
        """Return the arrays of one name in the order of their jobs, of those where columns have given values."""
        jobs = self.where(**fields)["job"].unique()
        return [self.by_job[job][name] for job in jobs if name in self.by_job.get(job, {})]

    def array(self, name: str, /, **fields: Any) -> AnyArray:
        """Return the only array of a name among the chosen jobs; a KeyError if there is none, or more than one."""
        found = self.arrays(name, **fields)
        if len(found) != 1:
            raise KeyError(f"Expected one array {name!r} where {fields}; there are {len(found)}.")
        return found[0]


def where(rows: pd.DataFrame, **fields: Any) -> pd.DataFrame:
    """Return the rows of a frame in which columns have given values; a KeyError if there is no such column."""
    chosen = np.ones(len(rows), dtype=bool)
    for column, value in fields.items():
        chosen &= (rows[column] == value).to_numpy()
    return cast(pd.DataFrame, rows[chosen])


def save(table: Table, folder: Path, meta: Mapping[str, Any]) -> None:
    """Write a table to a folder that exists, each file to its end or not at all.

    ``meta`` stands in ``meta.json`` beside the types of the columns; a column that mixes words, truth values and
    numbers, so that it would not be read back as it is, is a TypeError.
    """
    columns = {column: str(kind) for column, kind in table.rows.dtypes.items()}
    gaps = {column for column in columns if table.rows[column].isna().to_numpy().any()}
    if mixed := [c for c, kind in columns.items() if kind == "object" or (c in gaps and not kind.startswith("float"))]:
        raise TypeError(f"A column holds words, truth values or numbers; {', '.join(mixed)} mixes them or lacks some.")
    flat = {f"{job}|{name}": array for job, named in table.by_job.items() for name, array in named.items()}
    with atomic(folder / "rows.csv") as part:
        table.rows.to_csv(part, index=False, na_rep="nan")
    with atomic(folder / "arrays.npz") as part:
        np.savez_compressed(part, allow_pickle=False, **cast(Any, flat))
    with atomic(folder / "meta.json") as part:
        plant = {"plant": table.plant} if table.plant else {}
        text = json.dumps({**meta, "quick": table.quick, **plant, "columns": columns}, indent=2, default=str)
        part.write_text(text + "\n", encoding="utf-8")


def load(folder: Path) -> Table:
    """Return the table that :func:`save` wrote to a folder."""
    meta = json.loads((folder / "meta.json").read_text(encoding="utf-8"))
    by_job: dict[int, dict[str, AnyArray]] = {}
    with np.load(folder / "arrays.npz", allow_pickle=False) as stored:
        for key in stored.files:
            job, _, name = key.partition("|")
            by_job.setdefault(int(job), {})[name] = stored[key]
    plant = Plant(*meta["plant"]) if "plant" in meta else None
    return Table(read_rows(folder / "rows.csv", meta["columns"]), meta["quick"], by_job, plant)


def read_rows(file: Path, columns: Mapping[str, str] | None = None) -> pd.DataFrame:
    """Return the rows in ``rows.csv``, exactly as they were; without types of columns, as the values look."""
    return pd.read_csv(
        file,
        dtype=cast(Any, columns),
        keep_default_na=False,
        na_values=["nan"] if columns is None else {c: ["nan"] for c, kind in columns.items() if kind != "str"},
        encoding="utf-8",
    )
