r"""One law hands over to another where a region says so: swing up, then catch."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from dpend.arguments import checked_generator, checked_positive, checked_seed, checked_whole, is_finite
from dpend.controller import Act, Controller, Law, as_controller, is_batched, name_of
from dpend.deprecation import renamed_arguments
from dpend.laws import holding, log_of, with_logs
from dpend.params import Array
from dpend.plant import energies
from dpend.rig import Rig, as_rig, ideal_rig, single_rig
from dpend.rows import row_generators
from dpend.state import as_equilibrium, deviation, state_rows
from dpend.stepper import Stepper

from .lqr import LQR

Region = Callable[[Array], npt.NDArray[np.bool_]]
"""Which states ``(n, 6)`` belong to a region, ``(n,)``."""

Chosen = npt.NDArray[np.bool_]
"""Rows in which a law is in charge."""


class Ellipsoid:
    r"""Region :math:`(x - x^*)^\top P\,(x - x^*) \le c`, angles taken to the nearest turn.

    Called with states ``(n, 6)``, it says which are inside.

    Parameters
    ----------
    lqr : LQR
        Whose :math:`P` and :math:`x^*` count.
    level : float
        :math:`c`, greater than zero.

    Raises
    ------
    TypeError
        If ``lqr`` is none.
    ValueError
        If the level is not greater than zero.

    See Also
    --------
    controllers.RolloutRegion : By simulation, in every direction.

    Examples
    --------
    >>> import dpend
    >>> from controllers import LQR, Ellipsoid
    >>> rig = dpend.rig("gustafsson2016")
    >>> region = Ellipsoid(LQR(rig), 100.0)
    >>> region([[0, 0.01, 0.01, 0, 0, 0]])
    array([ True])
    """

    def __init__(self, lqr: LQR, level: float) -> None:
        self.lqr = _checked_lqr(lqr)
        self.level = checked_positive("level", level)

    def __repr__(self) -> str:
        return f"<region x'Px <= {self.level:.4g}>"

    def __call__(self, x: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return which states ``(n, 6)`` lie inside."""
        return self.cost(x) <= self.level

    def cost(self, x: npt.ArrayLike) -> Array:
        r"""Return :math:`(x - x^*)^\top P\,(x - x^*)` of states ``(n, 6)``.

        Near upright it is what LQR will have spent in the end.

        Parameters
        ----------
        x : array_like (n, 6)
            States.

        Returns
        -------
        ndarray (n,)
            Costs, in the units of LQR's.

        Raises
        ------
        ValueError
            If the states are not of that shape.

        See Also
        --------
        controllers.Ellipsoid.boundary : Where it is the level.

        Examples
        --------
        >>> import dpend
        >>> from controllers import LQR, Ellipsoid
        >>> rig = dpend.rig("gustafsson2016")
        >>> Ellipsoid(LQR(rig), 100.0).cost([[0, 0, 0, 0, 0, 0]])
        array([0.])
        """
        from_target = deviation(_rows(x), self.lqr.target)
        return np.einsum("ni,ij,nj->n", from_target, self.lqr.P, from_target)

    def boundary(self, n: int, rng: np.random.Generator) -> Array:
        """Draw ``n`` states on the boundary, uniform on the sphere of which it is the image.

        Directions that the ellipsoid stretches are drawn more often than by its surface.

        Parameters
        ----------
        n : int
            How many.
        rng : numpy.random.Generator
            What they are drawn from.

        Returns
        -------
        ndarray (n, 6)
            The states.

        Raises
        ------
        TypeError, ValueError
            If there is no such number, or no generator.

        See Also
        --------
        controllers.Ellipsoid.calibrated : Try them.

        Examples
        --------
        >>> import numpy as np
        >>> import dpend
        >>> from controllers import LQR, Ellipsoid
        >>> rig = dpend.rig("gustafsson2016")
        >>> region = Ellipsoid(LQR(rig), 100.0)
        >>> region.cost(region.boundary(2, np.random.default_rng(0))).round(6)
        array([100., 100.])
        """
        sphere = checked_generator("rng", rng).standard_normal((checked_whole("n", n), 6))
        sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
        half = np.linalg.cholesky(np.linalg.inv(self.lqr.P))
        return self.lqr.target + math.sqrt(self.level) * sphere @ half.T

    @classmethod
    def within_limits(cls, lqr: LQR) -> Ellipsoid:
        r"""Return the greatest on which the *linear* loop meets no limit of the rig.

        :math:`|Kx| \le u_\max` holds on :math:`x^\top P x \le u_\max^2 / (K P^{-1} K^\top)`, and the track's limit
        bounds the level likewise.  For the linearized plant that is invariant, and so a region of attraction; it knows
        nothing of what the sines do, and on most presets reaches beyond the horizontal.

        Parameters
        ----------
        lqr : LQR
            The law, with the rig whose limits count.

        Raises
        ------
        TypeError
            If ``lqr`` is none.
        ValueError
            If the rig has neither limit.
        """
        inverse = np.linalg.inv(_checked_lqr(lqr).P)
        force = float(lqr.rig.force_limit) ** 2 / float((lqr.K @ inverse @ lqr.K.T)[0, 0])
        track = max(float(lqr.rig.track_limit) - abs(float(lqr.target[0])), 1e-9) ** 2 / float(inverse[0, 0])
        if not math.isfinite(min(force, track)):
            raise ValueError("The rig limits neither force nor track, so the linear loop is stable everywhere.")
        return cls(lqr, min(force, track))

    @classmethod
    def calibrated(cls, lqr: LQR, *, starts: int = 1000, seed: int = 0, duration: float | None = None) -> Ellipsoid:
        """Return the greatest, to 2 %, from whose boundary the simulated, limited loop comes to rest from every start.

        The level is found by bisection over one set of directions, below that of :meth:`within_limits`.  It is an
        estimate and no proof: if none of n independent starts fails, then with 95 % confidence fewer than a share of
        3/n of the boundary does.

        Parameters
        ----------
        lqr : LQR
            The law, with the rig on which it is tried; delays, lag, noise and rounding are left out.
        starts : int
            Directions that must all come to rest.
        seed : int
            What they are drawn from.
        duration : float, optional
            Seconds until it is at rest; see :class:`RolloutRegion`.

        Raises
        ------
        TypeError
            If ``lqr`` is none.
        ValueError
            If another argument is wrong, or even a very small ellipsoid loses a start.
        """
        lqr, seed = _checked_lqr(lqr), checked_seed("seed", seed)
        rests = RolloutRegion(lqr.rig, lqr, target=lqr.target, duration=duration)

        def all_rest(level: float) -> bool:
            return bool(rests(cls(lqr, level).boundary(starts, np.random.default_rng(seed))).all())

        widest = 0.5 * np.pi / math.sqrt(np.linalg.inv(lqr.P)[1, 1])  # link 1 reaches the horizontal
        high = float(widest**2)
        if np.isfinite(lqr.rig.force_limit) or np.isfinite(lqr.rig.track_limit):
            high = min(high, cls.within_limits(lqr).level)
        low = 1e-6 * high
        if not all_rest(low):
            raise ValueError(f"{lqr!r} does not bring its rig to rest even from next to the target.")
        if all_rest(high):
            return cls(lqr, high)
        while high / low > 1.02:
            middle = math.sqrt(low * high)
            low, high = (middle, high) if all_rest(middle) else (low, middle)
        return cls(lqr, low)


def _rows(x: npt.ArrayLike) -> Array:
    states = state_rows("x", x)
    if states.ndim != 2:
        raise ValueError(f"Expected states (n, 6); got shape {states.shape}.")
    return states


def _checked_lqr(lqr: object) -> LQR:
    if not isinstance(lqr, LQR):
        raise TypeError(f"Ellipsoid takes an LQR; got {lqr!r}.")
    return lqr


@renamed_arguments(about="target", law="controller")
class RolloutRegion:
    """The states from which a law, simulated on the rig as it is believed to be, comes to rest on the track.

    That is the region of attraction itself as far as the model knows it, force and track limits included, at the cost
    of a simulation: states with a link beyond the horizontal, as seen from the target, are not tried, and those that
    fall on the way are abandoned at once.

    Parameters
    ----------
    rig : Rig or str
        What is believed.  Delays, lag, noise and rounding are left out: the states asked about are estimates already.
    controller : Controller
        A batched law, started afresh for each question.
    target : str or array_like (6,)
        The equilibrium at which it must arrive.
    duration : float, optional
        Seconds simulated; left out, eight times the square root of the links' length over gravity.
    within : float
        Both links must be within this angle of the target's during the last quarter of that time, rad.

    Raises
    ------
    TypeError
        If ``controller`` is no controller.
    ValueError
        If it is not batched, the rig describes several plants, or a number is not greater than zero.

    See Also
    --------
    controllers.Ellipsoid : Without a simulation.

    Examples
    --------
    >>> import numpy as np
    >>> import dpend
    >>> from controllers import LQR, RolloutRegion
    >>> rig = dpend.rig("gustafsson2016")
    >>> RolloutRegion(rig, LQR(rig))(np.array([[0, 0.1, -0.1, 0, 0, 0], [0, 2.0, 0, 0, 0, 0]]))
    array([ True, False])
    """

    def __init__(
        self,
        rig: Rig | str,
        controller: Controller,
        *,
        target: str | npt.ArrayLike = "up-up",
        duration: float | None = None,
        within: float = 0.2,
    ) -> None:
        rig = single_rig(rig, "RolloutRegion")
        self.controller = controller = as_controller(controller)
        if not is_batched(controller):
            raise ValueError(
                f"{name_of(controller)} treats one run at a time; a rollout of many states takes a batched law."
            )
        if duration is None:
            c = rig.params.coefficients()
            duration = 8 * math.sqrt(float(c.length1 + c.length2) / max(float(rig.params.gravity), 1.0))
        self.duration = checked_positive("duration", duration, "s")
        self.within = checked_positive("within", within, "rad")
        self.rig = ideal_rig(rig, limits=True)
        self.target = as_equilibrium(target)

    def __repr__(self) -> str:
        return f"<region from which {name_of(self.controller)} comes to rest in {self.duration:.3g} s>"

    def __call__(self, x: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return from which states ``(n, 6)`` the law comes to rest."""
        x = _rows(x)
        rests = np.zeros(len(x), dtype=np.bool_)
        rows = np.flatnonzero(~self.fallen(x) & (np.abs(x[:, 0]) <= self.rig.track_limit))
        if not len(rows):
            return rests
        stepper = Stepper(self.rig, len(rows))
        y = stepper.reset(x[rows])
        act = self.controller.start(len(rows), np.random.default_rng(0))
        samples = max(1, round(self.duration / self.rig.sample_time))
        alive = np.ones(len(rows), dtype=np.bool_)
        for k in range(samples):
            y = stepper.step(act(k * self.rig.sample_time, y))
            late = 4 * (k + 1) > 3 * samples
            alive &= ~self.fallen(y, self.within if late else 0.5 * np.pi) & (np.abs(y[:, 0]) <= self.rig.track_limit)
            if not alive.all():
                if not alive.any():
                    return rests
                y[~alive] = stepper.reset(self.target, ~alive)  # parked, where it disturbs no row
        rests[rows] = alive
        return rests

    def fallen(self, x: Array, angle: float = 0.5 * np.pi) -> npt.NDArray[np.bool_]:
        """Return which states ``(n, 6)`` have a link further than an angle from the target's, horizontal by default.

        Such states are not simulated.

        Parameters
        ----------
        x : ndarray (n, 6)
            States.
        angle : float
            The angle, rad.

        Returns
        -------
        ndarray (n,) of bool
            Which.

        See Also
        --------
        controllers.SwitchingController : Hand back by it.

        Examples
        --------
        >>> import numpy as np
        >>> import dpend
        >>> from controllers import LQR, RolloutRegion
        >>> rig = dpend.rig("gustafsson2016")
        >>> RolloutRegion(rig, LQR(rig)).fallen(np.array([[0, 2.0, 0, 0, 0, 0]]))
        array([ True])
        """
        return ~(np.abs(deviation(x, self.target)[:, 1:3]).max(axis=1) <= angle)


class NearEnergy:
    r"""Region :math:`|E - E_r| \le \varepsilon E_r` with the cart off its track's ends: upright's energy, anywhere.

    It says nothing of how fast and where the links are; a planner takes over there, not a regulator.

    Parameters
    ----------
    rig : Rig or str
        The plant and its track.
    tolerance : float
        :math:`\varepsilon`, greater than zero.
    track_share : float
        Share of the track within which the cart must be, above zero and at most one.

    Raises
    ------
    ValueError
        If the rig describes several plants, or a number is out of range.

    See Also
    --------
    controllers.EnergyPump : Bring it there.
    controllers.SwitchingController : Whose region it may be.

    Examples
    --------
    >>> import numpy as np
    >>> import dpend
    >>> from controllers import NearEnergy
    >>> rig = dpend.rig("gustafsson2016")
    >>> NearEnergy(rig)(np.zeros((1, 6)))
    array([ True])
    """

    def __init__(self, rig: Rig | str, tolerance: float = 0.15, *, track_share: float = 0.8) -> None:
        rig = single_rig(rig, "NearEnergy")
        if not (is_finite(tolerance) and is_finite(track_share) and tolerance > 0 and 0 < track_share <= 1):
            raise ValueError(
                f"tolerance must be greater than 0 and track_share above 0 and at most 1; "
                f"got {tolerance!r} and {track_share!r}."
            )
        c = rig.params.coefficients()
        self.rig = rig
        self.energy = float(c.f1 + c.f2)
        self.tolerance = float(tolerance)
        self.track_share = float(track_share)

    def __repr__(self) -> str:
        return f"<region |E - Er| <= {self.tolerance:g} Er>"

    def __call__(self, x: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return which states ``(n, 6)`` lie inside."""
        x = _rows(x)
        near = np.abs(energies(x, self.rig.params).total - self.energy) <= self.tolerance * self.energy
        return near & (np.abs(x[:, 0]) <= self.track_share * self.rig.track_limit)


class SwitchingController:
    r"""Law ``first`` until the state is in a region, then law ``then``; back again where the state is lost.

    Switching controllers nest: ``SwitchingController(rig, EnergyPump(rig), planner)`` as the ``first`` of another pumps
    energy, plans the last swing, and balances.  A batched law runs along from the start in every row and is used where
    it is in charge.  A planner, and any law that treats a single run at a time, starts afresh whenever it is put in
    charge: a class says so by ``starts_afresh = True`` or ``batched = False``, and so do laws around one.

    Parameters
    ----------
    rig : Rig or str
        What is believed.
    first : Controller
        Any law, such as :class:`~controllers.energy.EnergyPump`.
    then : Controller, optional
        The law that catches; left out, ``LQR(rig)``.
    region : callable, optional
        Which states ``(n, 6)`` are handed over, ``(n,)``: :class:`Ellipsoid`, :class:`RolloutRegion`,
        :class:`NearEnergy` or any function.  Left out, ``RolloutRegion`` where ``then`` is an LQR: the states from
        which that law comes to rest; ``NearEnergy`` for a law that starts afresh; required otherwise.
    leave : callable, optional
        Which states are handed back.  It is asked only while ``then`` is in charge, so that it makes the hysteresis.
        Left out, those with a link beyond the horizontal, as seen from the target, where ``then`` is an LQR; for any
        other law none.

    Raises
    ------
    TypeError
        If a law is no controller, or a region cannot be called.
    ValueError
        If the rig describes several plants, or there is no region by default.

    See Also
    --------
    controllers.RolloutRegion : Where the second takes over.
    controllers.EnergyPump : A first law.

    Notes
    -----
    A batched law that counts its samples, such as :class:`~controllers.tvlqr.TVLQR`, or remembers what it commanded,
    ages while it is not in charge.

    ``act.log["caught"]`` says for each call where ``then`` was in charge.  Otherwise the log is, row by row, that of
    the law in charge, NaN where it has no entry of that name; the ``caught`` of a nested one is found under
    ``first.caught`` or ``then.caught``.

    Examples
    --------
    >>> import dpend
    >>> from controllers import EnergyPump, ILQRMPC, LQR, SwitchingController
    >>> rig = dpend.rig("gustafsson2016")
    >>> planner = ILQRMPC(rig, horizon=0.8)
    >>> three = SwitchingController(rig, SwitchingController(rig, EnergyPump(rig), planner), LQR(rig))
    >>> dpend.simulate(rig, three, dpend.EQUILIBRIA["down-down"], task=dpend.SwingUp(steps=400)).success
    True
    """

    def __init__(
        self,
        rig: Rig | str,
        first: Controller | Law,
        then: Controller | Law | None = None,
        *,
        region: Region | None = None,
        leave: Region | None = None,
    ) -> None:
        rig = as_rig(rig)
        self.rig = rig
        self.first = as_controller(first)
        self.then: Controller = LQR(rig) if then is None else as_controller(then)
        for name, asked in (("region", region), ("leave", leave)):
            if asked is not None and not callable(asked):
                raise TypeError(f"{name} must say which states (n, 6) belong to it, as a function; got {asked!r}.")
        if isinstance(self.then, LQR):
            ahead = RolloutRegion(rig, self.then, target=self.then.target)
            self.region: Region = ahead if region is None else region
            self.leave: Region = ahead.fallen if leave is None else leave
        elif region is None and not _starts_afresh(self.then):
            raise ValueError(
                f"Say in which region {name_of(self.then)} is to take over, region=...; only an LQR and laws that "
                "start afresh, such as planners, have one by default."
            )
        else:
            self.region = NearEnergy(rig) if region is None else region
            self.leave = _nowhere if leave is None else leave
        self.batched = is_batched(self.first) and is_batched(self.then)
        self.starts_afresh = _starts_afresh(self.first) or _starts_afresh(self.then)
        self.name = f"{name_of(self.first)}, then {name_of(self.then)}"

    def __repr__(self) -> str:
        return f"<{self.name}>"

    def start(self, n: int, rng: np.random.Generator) -> Act:
        """Return the law for ``n`` runs."""
        caught = np.zeros(n, dtype=np.bool_)
        everywhere = np.ones(n, dtype=np.bool_)
        laws = [_Afresh(law, n, rng) if _starts_afresh(law) else _Along(law, n, rng) for law in (self.first, self.then)]
        log: dict[str, list[Array]] = {"caught": []}

        def among(t: float, y: Array, rows: Chosen) -> Array:
            """Return the forces where this law is in charge; the other rows begin anew when they are next."""
            nonlocal caught
            staying, free = rows & caught, rows & ~caught
            caught = np.zeros(n, dtype=np.bool_)
            if staying.any():
                caught[staying] = ~np.asarray(self.leave(y[staying]), dtype=np.bool_)
            if free.any():
                caught[free] = self.region(y[free])
            forces = np.zeros(n)
            entries: dict[str, Array] = {}
            for role, law, chosen in zip(("first", "then"), laws, (rows & ~caught, rows & caught), strict=True):
                np.copyto(forces, law(t, y, chosen, rows), where=chosen)
                for name, entry in law.entries().items():
                    name = f"{role}.{name}" if name == "caught" else name
                    np.copyto(entries.setdefault(name, np.full(n, np.nan)), entry, where=chosen)
            for name in {*entries, *log} - {"caught"}:
                gone = [np.full(n, np.nan)] * len(log["caught"])  # calls in which no law in charge had such an entry
                log.setdefault(name, gone).append(entries.get(name, np.full(n, np.nan)))
            log["caught"].append(caught.astype(np.float64))
            return forces

        act = holding(n, with_logs(lambda t, y: among(t, y, everywhere), log))
        if all(law.forgets for law in laws):
            act.among = among  # type: ignore[attr-defined]
        return act


# A law at work may have a method ``among(t, y, rows)``, forces (n,) where it is in charge: the other rows take no time
# and are forgotten.  So a planner starts afresh row by row, and still plans for many rows at once.


def _starts_afresh(law: Controller) -> bool:
    """Return whether a law starts afresh whenever it is put in charge, or is around one that does."""
    inner = getattr(law, "controller", None)
    says_so = not is_batched(law) or bool(getattr(law, "starts_afresh", False))
    return says_so or (inner is not None and _starts_afresh(inner))


class _Along:
    """A batched law that answers in every row, whichever law is in charge."""

    def __init__(self, law: Controller, n: int, rng: np.random.Generator) -> None:
        self._act = law.start(n, rng)
        self._among = getattr(self._act, "among", None)
        self.forgets = self._among is not None

    def __call__(self, t: float, y: Array, chosen: Chosen, rows: Chosen) -> Array:
        return self._act(t, y) if self._among is None else self._among(t, y, rows)

    def entries(self) -> dict[str, Array]:
        """Return what the law logged in the last call."""
        return {name: entries[-1] for name, entries in log_of(self._act).items()}


class _Afresh:
    """A law that is started when it is put in charge: all rows together where it can be, else row by row."""

    forgets = True

    def __init__(self, law: Controller, n: int, rng: np.random.Generator) -> None:
        self._law = law
        self._rngs = row_generators(rng, n)
        self._act = law.start(n, rng) if is_batched(law) else None
        self._among = getattr(self._act, "among", None)
        self._chosen = np.zeros(n, dtype=np.bool_)
        self._running: list[tuple[float, Act] | None] = [None] * n

    def __call__(self, t: float, y: Array, chosen: Chosen, rows: Chosen) -> Array:
        before, self._chosen = self._chosen, chosen
        if self._among is not None:
            return self._among(t, y, chosen) if before.any() or chosen.any() else np.zeros(len(y))
        u = np.zeros(len(y))
        for row in range(len(y)):
            if not chosen[row]:
                self._running[row] = None
                continue
            began, act = self._running[row] or (t, self._law.start(1, self._rngs[row]))
            self._running[row] = began, act
            u[row] = act(t - began, y[row : row + 1])[0]
        return u

    def entries(self) -> dict[str, Array]:
        """Return what the law logged in the last call, NaN in the rows where it is not running."""
        if self._act is not None and self._among is not None:
            return {name: log[-1] for name, log in log_of(self._act).items()} if self._chosen.any() else {}
        found: dict[str, Array] = {}
        for row, running in enumerate(self._running):
            for name, entries in log_of(running[1]).items() if running else ():
                found.setdefault(name, np.full(len(self._running), np.nan))[row] = np.ravel(entries[-1])[0]
        return found


def _nowhere(x: Array) -> npt.NDArray[np.bool_]:
    return np.zeros(len(x), dtype=np.bool_)
