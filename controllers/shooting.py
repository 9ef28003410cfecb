r"""Optimal control by direct multiple shooting: the nonlinear program of a sampled plant, derived stage by stage.

.. math::
    \min_{x, u} \sum_{k<N} \ell(x_k, u_k, p_k) + V(x_N, p_N)
    \quad\text{with}\quad x_{k+1} = F(x_k, u_k),\quad h(x_k, p_k) \text{ and the variables within bounds.}

CasADi could derive all of it by itself.  Done by hand from one stage, mapped over the horizon, what is to be compiled
neither grows with the horizon nor with the number of Runge-Kutta steps in a sample, and nothing is evaluated twice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np

from .codegen import NLPSolver, Plugin, nlp_solver

_QUIET = {"print_time": False, "show_eval_warnings": False, "calc_lam_p": False}


@dataclass(frozen=True, kw_only=True)
class Stage:
    r"""One stage of an optimal control problem, in CasADi symbols.

    Parameters
    ----------
    x, u, p : casadi.SX
        State, input and parameters.
    step : casadi.Function
        :math:`(x, u) \mapsto x^+`, one of the equal steps that make a sample.
    steps : int
        How many of them do.
    cost, terminal : casadi.SX
        :math:`\ell(x, u, p)` and :math:`V(x, p)`.
    path : casadi.SX, optional
        :math:`h(x, p)`.
    curvature, terminal_curvature : casadi.SX, optional
        What stands for the second derivatives of either cost by :math:`(x, u)` and by :math:`x`; left out, they do.
    second_order : bool
        Whether the plant's second derivatives are in the Hessian; without, it is Gauss and Newton's if the curvatures
        are.
    """

    x: Any
    u: Any
    p: Any
    step: Any
    steps: int
    cost: Any
    terminal: Any
    path: Any = None
    curvature: Any = None
    terminal_curvature: Any = None
    second_order: bool = True


@dataclass(frozen=True)
class Program:
    """A nonlinear program in the order ``x0, u0, x1, u1, ..., xN``, and how to write and read its vectors.

    Attributes
    ----------
    nlp : dict
        For ``casadi.nlpsol``.
    derivatives : tuple of casadi.Function
        What fatrop asks for.
    equality : list of bool
        Which constraints close the gaps between stages.
    horizon, nx, nu, nh : int
        Stages, and the sizes of a state, an input and a path constraint.
    """

    nlp: dict[str, Any]
    derivatives: tuple[Any, ...]
    equality: list[bool]
    horizon: int
    nx: int
    nu: int
    nh: int

    def solver(
        self,
        *,
        fatrop: Mapping[str, Any],
        ipopt: Mapping[str, Any],
        solver: Plugin = "auto",
        compiled: bool = True,
    ) -> NLPSolver:
        """Return a silent solver, by :func:`controllers.codegen.nlp_solver`, given the options of either's own."""
        stages = {"structure_detection": "auto", "equality": self.equality}
        return nlp_solver(
            self.nlp,
            solver=solver,
            fatrop=_QUIET | stages | {"fatrop": {"print_level": 0} | dict(fatrop)},
            ipopt=_QUIET | {"ipopt": {"print_level": 0, "sb": "yes"} | dict(ipopt)},
            compiled=compiled,
            derivatives=self.derivatives,
        )

    def pack(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return states ``(N + 1, nx)`` and inputs ``(N, nu)`` as one vector."""
        return np.concatenate([np.hstack([x[:-1], u]).ravel(), x[-1]])

    def unpack(self, w: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return states ``(N + 1, nx)`` and inputs ``(N, nu)`` of a vector."""
        w = np.asarray(w, dtype=np.float64).ravel()
        stages = w[: -self.nx].reshape(self.horizon, self.nx + self.nu)
        return np.vstack([stages[:, : self.nx], w[-self.nx :]]), stages[:, self.nx :].copy()

    def constraints(self, gaps: float, path: float) -> np.ndarray:
        """Return a vector of the constraints' size, one number for the gaps and one for the path constraints."""
        stage = np.concatenate([np.full(self.nx, gaps), np.full(self.nh, path)])
        return np.concatenate([np.tile(stage, self.horizon), np.full(self.nh, path)])


def multiple_shooting(stage: Stage, horizon: int) -> Program:
    """Return the nonlinear program of :math:`N` = ``horizon`` equal stages, at least 2.

    Its parameters are those of all stages, ``(p0, ..., pN)``.
    """
    x, u, p = stage.x, stage.u, stage.p
    nx, nu, npar, N = x.numel(), u.numel(), p.numel(), horizon
    nz = nx + nu
    z = casadi.vertcat(x, u)
    path = casadi.SX(0, 1) if stage.path is None else stage.path
    nh = path.numel()
    options = {"cse": True}

    # One stage: values, first and second derivatives.
    sample, tangent, bend = _sample(stage.step, stage.steps, nx, nu, stage.second_order)
    cost = casadi.Function("cost", [x, u, p], [stage.cost], options)
    slope = casadi.Function("slope", [x, u, p], [casadi.gradient(stage.cost, z)], options)
    terminal = casadi.Function("terminal", [x, p], [stage.terminal], options)
    terminal_slope = casadi.Function("terminal_slope", [x, p], [casadi.gradient(stage.terminal, x)], options)
    path_value = casadi.Function("path_value", [x, p], [path], options)
    path_slope = casadi.Function("path_slope", [x, p], [casadi.densify(casadi.jacobian(path, x))], options)
    nu_path = casadi.SX.sym("nu", nh)
    bent_path = casadi.dot(nu_path, path) if nh else casadi.SX(0)
    curvature = casadi.hessian(stage.cost, z)[0] if stage.curvature is None else stage.curvature
    final = casadi.hessian(stage.terminal, x)[0] if stage.terminal_curvature is None else stage.terminal_curvature
    path_bend = casadi.densify(casadi.hessian(bent_path, x)[0])
    scale = casadi.SX.sym("scale")
    over = casadi.diagcat(path_bend, casadi.SX(nu, nu)) if nh else casadi.SX(nz, nz)
    curve = casadi.Function("curve", [x, u, p, scale, nu_path], [casadi.densify(scale * curvature + over)], options)
    terminal_curve = casadi.Function(
        "terminal_curve", [x, p, scale, nu_path], [casadi.densify(scale * final + path_bend)], options
    )

    # The stage as it is mapped: in the order of the nonzeros of the program's matrices.
    X, U, P = casadi.MX.sym("x", nx), casadi.MX.sym("u", nu), casadi.MX.sym("p", npar)
    ahead, J = tangent(X, U)
    C = casadi.horzcat(path_slope(X, P), casadi.MX.zeros(nh, nu))
    columns = [casadi.vertcat(*([1.0] if i < nx else []), -J[:, i], C[:, i]) for i in range(nz)]
    first_columns = [casadi.vertcat(-J[:, i], C[:, i]) for i in range(nz)]
    inside = casadi.Function("inside", [X, U, P], [ahead, casadi.vertcat(*columns)])
    outset = casadi.Function("outset", [X, U, P], [ahead, casadi.vertcat(*first_columns)])
    lam, mu, s = casadi.MX.sym("lam", nx), casadi.MX.sym("mu", nh), casadi.MX.sym("s")
    pulled, H = bend(X, U, lam)
    gradient = s * slope(X, U, P) - pulled
    if nh:
        gradient += casadi.vertcat(casadi.mtimes(path_slope(X, P).T, mu), casadi.MX.zeros(nu))
    block = casadi.vec(curve(X, U, P, s, mu) - H)
    second = casadi.Function("second", [X, U, P, s, lam, mu], [gradient, block])

    # The whole.
    w = casadi.MX.sym("w", N * nz + nx)
    par = casadi.MX.sym("p", (N + 1) * npar)
    stages = casadi.reshape(w[: N * nz], nz, N)
    xs, us, last = stages[:nx, :], stages[nx:, :], w[N * nz :]
    ps = casadi.reshape(par[: N * npar], npar, N)
    p_last = par[N * npar :]
    nexts = casadi.horzcat(xs[:, 1:], last)
    f = casadi.sum2(cost.map(N)(xs, us, ps)) + terminal(last, p_last)
    path_last = path_value(last, p_last)

    def constraints(ends: Any) -> Any:
        return casadi.vertcat(casadi.vec(casadi.vertcat(nexts - ends, path_value.map(N)(xs, ps))), path_last)

    g = constraints(sample.map(N)(xs, us))
    # Dense, whatever a cost does not depend on: fatrop reads the gradient as it lies in memory.
    grad_f = casadi.densify(casadi.vertcat(casadi.vec(slope.map(N)(xs, us, ps)), terminal_slope(last, p_last)))

    first_end, first_nonzeros = outset(xs[:, 0], us[:, 0], ps[:, 0])
    ends, nonzeros = inside.map(N - 1)(xs[:, 1:], us[:, 1:], ps[:, 1:])
    C_last = path_slope(last, p_last)
    last_nonzeros = casadi.vertcat(*[casadi.vertcat(1.0, C_last[:, i]) for i in range(nx)])
    jacobian = casadi.MX(
        _jacobian_sparsity(N, nx, nu, nh), casadi.vertcat(first_nonzeros, casadi.vec(nonzeros), last_nonzeros)
    )

    s = casadi.MX.sym("lam_f")
    lam_g = casadi.MX.sym("lam_g", g.numel())
    multipliers = casadi.reshape(lam_g[: N * (nx + nh)], nx + nh, N)
    lams, mus, mu_last = multipliers[:nx, :], multipliers[nx:, :], lam_g[N * (nx + nh) :]
    gradients, blocks = second.map(N)(xs, us, ps, casadi.repmat(s, 1, N), lams, mus)
    grad_last = s * terminal_slope(last, p_last)
    if nh:
        grad_last += casadi.mtimes(C_last.T, mu_last)
    # A gap x_{k+1} - F(x_k, u_k) pulls at its end too.
    pulls = casadi.horzcat(casadi.MX.zeros(nx, 1), lams[:, : N - 1])
    gradients += casadi.vertcat(pulls, casadi.MX.zeros(nu, N))
    grad_l = casadi.vertcat(casadi.vec(gradients), grad_last + lams[:, N - 1])
    dense = [casadi.Sparsity.dense(nz, nz)] * N + [casadi.Sparsity.dense(nx, nx)]
    hessian = casadi.MX(
        casadi.Sparsity(casadi.diagcat(*dense)),
        casadi.vertcat(casadi.vec(blocks), casadi.vec(terminal_curve(last, p_last, s, mu_last))),
    )

    ins, outs = [w, par], ["x", "p"]
    derivatives = (
        casadi.Function("nlp", ins, [f, g], outs, ["f", "g"]),
        casadi.Function("nlp_f", ins, [f], outs, ["f"]),
        casadi.Function("nlp_g", ins, [g], outs, ["g"]),
        casadi.Function("nlp_grad_f", ins, [grad_f], outs, ["grad_f_x"]),
        casadi.Function(
            "nlp_jac_g",
            ins,
            [constraints(casadi.horzcat(first_end, ends)), jacobian],
            outs,
            ["g", "jac_g_x"],
        ),
        casadi.Function(  # what CasADi evaluates at the end; of the derivatives by parameters nothing is asked
            "nlp_grad",
            [w, par, s, lam_g],
            [f, g, grad_l, casadi.MX(*par.shape)],
            ["x", "p", "lam_f", "lam_g"],
            ["f", "g", "grad_gamma_x", "grad_gamma_p"],
        ),
        casadi.Function(
            "nlp_hess_l",
            [w, par, s, lam_g],
            [grad_l, hessian],
            ["x", "p", "lam_f", "lam_g"],
            ["grad_gamma_x", "hess_gamma_x_x"],
        ),
    )
    equality = ([True] * nx + [False] * nh) * N + [False] * nh
    return Program({"x": w, "p": par, "f": f, "g": g}, derivatives, equality, N, nx, nu, nh)


def _jacobian_sparsity(N: int, nx: int, nu: int, nh: int) -> Any:
    """Where the constraints' Jacobian has nonzeros: dense blocks of each stage, and a one where a gap ends."""
    rows: list[int] = []
    colind = [0]
    for k in range(N + 1):
        height = nx + nh if k < N else nh
        block = range(k * (nx + nh), k * (nx + nh) + height)
        for i in range(nx + nu if k < N else nx):
            if k > 0 and i < nx:
                rows.append((k - 1) * (nx + nh) + i)
            rows.extend(block)
            colind.append(len(rows))
    return casadi.Sparsity(N * (nx + nh) + nh, N * (nx + nu) + nx, colind, rows)


def _sample(step: Any, steps: int, nx: int, nu: int, second_order: bool) -> tuple[Any, Any, Any]:
    r"""Return a sample of several steps, with its Jacobian, and with its second derivatives along a multiplier.

    With :math:`T_i` the derivative of :math:`(x_i, u)` by :math:`(x_0, u)` and :math:`\lambda_i` the multiplier pulled
    back from the end, the second derivative of :math:`\lambda^\top F` is
    :math:`\sum_i T_i^\top H_i(\lambda_{i+1})\,T_i`.
    """
    x, u, lam = casadi.SX.sym("x", nx), casadi.SX.sym("u", nu), casadi.SX.sym("lam", nx)
    z = casadi.vertcat(x, u)
    after = step(x, u)
    options = {"cse": True}
    value = casadi.Function("value", [x, u], [after], options)
    first = casadi.Function("first", [x, u], [after, casadi.densify(casadi.jacobian(after, z))], options)
    H, _ = casadi.hessian(casadi.dot(lam, after), z)
    twice = casadi.Function("twice", [x, u, lam], [casadi.densify(H)], options)

    X, U, L = casadi.MX.sym("x", nx), casadi.MX.sym("u", nu), casadi.MX.sym("lam", nx)
    held = casadi.horzcat(casadi.MX.zeros(nu, nx), casadi.MX.eye(nu))
    end, states, tangents, jacobians = X, [], [casadi.MX.eye(nx + nu)], []
    plain = X
    for _ in range(steps):
        plain = value(plain, U)
        states.append(end)
        end, J = first(end, U)
        jacobians.append(J)
        tangents.append(
            casadi.vertcat(J, held) if len(tangents) == 1 else casadi.mtimes(casadi.vertcat(J, held), tangents[-1])
        )
    total = casadi.densify(tangents[-1][:nx, :])
    second = casadi.MX.zeros(nx + nu, nx + nu)
    if second_order:
        pulled = L
        for i in reversed(range(steps)):
            H = twice(states[i], U, pulled)
            second += H if i == 0 else casadi.mtimes([tangents[i].T, H, tangents[i]])
            pulled = casadi.mtimes(jacobians[i][:, :nx].T, pulled)
    return (
        casadi.Function("sample", [X, U], [plain]),
        casadi.Function("tangent", [X, U], [end, total]),
        casadi.Function("bend", [X, U, L], [casadi.mtimes(total.T, L), second]),
    )
