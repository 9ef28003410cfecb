"""The plant of a job: a rig by its name and with every number, so that neither a key nor a table can mistake it."""

from __future__ import annotations

import json
from functools import cache
from typing import NamedTuple

import dpend
from dpend import Rig

DEFAULT_RIG = "gustafsson2016"
"""The rig of the comparisons, for which policies and tables are shipped."""


class Plant(NamedTuple):
    """A rig as a job names it: a column of the table by its name, and in the job's key with every number."""

    name: str  # That of ``--rig``, and what ``--set`` changed.
    definition: str  # JSON of all its fields.

    @property
    def rig(self) -> Rig:
        """The rig itself."""
        return _rig(self.definition)


@cache
def _rig(definition: str) -> Rig:
    return Rig.from_dict(json.loads(definition))


def rig_of(plant: Plant | None) -> Rig:
    """Return the rig of a job or table: without a plant, that of the comparisons."""
    return plant.rig if plant else _default()


@cache
def _default() -> Rig:
    return dpend.rig(DEFAULT_RIG)
