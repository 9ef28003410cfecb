"""A controller around another, which passes on what the law inside logs."""

from __future__ import annotations

import numpy as np

from dpend.controller import Act, Controller, Law, as_controller, is_batched, name_of
from dpend.laws import holding, log_of, with_logs


class Wrapper:
    """A controller around another: batched if that is, with its log, under a name made from its name.

    A subclass says in ``_around`` what becomes of the wrapped law, which may be a plain function ``law(t, x)`` of one
    state; in ``name``, ``{}`` stands for its name.
    """

    def __init__(self, controller: Controller | Law, name: str) -> None:
        self.controller = as_controller(controller)
        self.batched = is_batched(self.controller)
        self.name = name.replace("{}", name_of(self.controller))

    def __repr__(self) -> str:
        return f"<{self.name}>"

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        inner = self.controller.start(n, rng)
        return holding(n, with_logs(self._around(n, inner), log_of(inner)))

    def _around(self, n: int, inner: Act) -> Act:
        """Return the law for ``n`` runs around the wrapped law at work."""
        raise NotImplementedError
