# pyright: reportMissingImports=false
"""PILCO itself: a Gaussian process of the plant, a policy of radial basis functions, exact moments between them.

Run ``python -m examples.pilco --seed 0``; it needs JAX, of the extra ``jax``.  The plant is the single
cart-pole on which the paper explains the algorithm: the double pendulum with a second link of a milligram, too
light to move anything.  State s = (p, θ, v, ω), θ = 0 upright; a trial is four seconds from hanging.  After each

1. the change of each component over a sample gets a Gaussian process of (p, v, ω, sin θ, cos θ, u), whose
   hyperparameters are of greatest marginal likelihood;
2. the policy's parameters descend the gradient of the expected cost over the next four seconds, E Σ 1 - exp(-d²/2σ²)
   of the tip's distance d from its place upright.  The state's distribution is taken for Gaussian after each sample,
   with the mean and covariance that the process gives it exactly.

Source: M. Deisenroth and C. Rasmussen, *PILCO: a model-based and data-efficient approach to policy search*, ICML 2011;
equations in M. Deisenroth, *Efficient reinforcement learning using Gaussian processes*, KIT 2010, chapters 2 and 3.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jax.flatten_util import ravel_pytree
from scipy.optimize import minimize

import dpend

jax.config.update("jax_enable_x64", True)

RIG = dpend.rig("pilco2011").replace(mass2=1e-6, force_limit=10.0, sample_time=0.1, substeps=10)
HANGING = np.array([0.0, np.pi, np.pi, 0.0, 0.0, 0.0])
SECONDS = 4.0
SAMPLES = round(SECONDS / RIG.sample_time)
LENGTH, FORCE = float(RIG.params.length1), RIG.force_limit
_FIRST = jnp.array([0.0, np.pi, 0.0, 0.0]), 0.1**2 * jnp.eye(4)  # distribution of a trial's start
_WIDTH = 0.25  # m: σ of the cost
_OF_VALUES = 0.0, float(np.log(0.01))  # logarithms of a policy's amplitude and of the noise that smooths its values
_GREATEST_RATIO = 500.0  # of signal to noise, above which a kernel's matrix has no inverse


@dataclass(frozen=True)
class Options:
    """How much is learned, and from what."""

    trials: int = 10  # of four seconds, after one of random forces
    seed: int = 0  # of starts, noise, random forces and the first policy
    basis: int = 10  # radial basis functions of the policy
    descents: int = 150  # steps of L-BFGS for the policy, each trial

    def __post_init__(self) -> None:
        for name, least in (("trials", 1), ("seed", 0), ("basis", 1), ("descents", 1)):
            if (value := getattr(self, name)) < least:
                raise ValueError(f"--{name} must be at least {least}; got {value}.")


class Process(NamedTuple):
    """Gaussian processes of E outputs on n inputs of D numbers, kernel a² exp(-½ Σ (x - x')²/l²)."""

    inputs: Any  # (n, D)
    weights: Any  # (E, n): inverse of the kernel's matrix times the targets
    inverse: Any  # (E, n, n): that inverse; zeros where only the mean counts, as for a policy
    scales: Any  # (E, D): l
    amplitudes: Any  # (E,): a


def moments(process: Process, mean: Any, cov: Any) -> tuple[Any, Any, Any]:
    """Return mean ``(E,)`` and covariance ``(E, E)`` of a process at N(mean, cov), and its slope ``(D, E)``.

    The covariance of input and output is ``cov @ slope``.
    """
    apart, (outputs, size) = process.inputs - mean, process.scales.shape
    eye = jnp.eye(size)

    def first(scales: Any, amplitude: Any, weights: Any) -> tuple[Any, Any]:
        scaled = apart / scales
        spread = cov / jnp.outer(scales, scales) + eye
        solved = jnp.linalg.solve(spread, scaled.T).T
        each = weights * jnp.exp(-0.5 * jnp.sum(scaled * solved, axis=1))
        each *= amplitude**2 / jnp.sqrt(jnp.linalg.det(spread))
        return each.sum(), (solved / scales).T @ each

    middle, slope = jax.vmap(first)(process.scales, process.amplitudes, process.weights)
    log_kernels = 2 * jnp.log(process.amplitudes)[:, None] - 0.5 * jnp.sum(
        (apart / process.scales[:, None]) ** 2, axis=2
    )

    def second(a: Any, b: Any) -> Any:
        left, right = apart / process.scales[a] ** 2, apart / process.scales[b] ** 2
        spread = cov * (process.scales[a] ** -2 + process.scales[b] ** -2) + eye
        half = 0.5 * jnp.linalg.solve(spread, cov)
        exponent = log_kernels[a][:, None] + log_kernels[b] + jnp.sum(left @ half * left, axis=1)[:, None]
        exponent += jnp.sum(right @ half * right, axis=1) + 2 * left @ half @ right.T
        both = jnp.exp(exponent) / jnp.sqrt(jnp.linalg.det(spread))
        own = jnp.where(a == b, jnp.sum(process.inverse[a] * both), 0.0)
        return process.weights[a] @ both @ process.weights[b] - own

    rows, columns = np.triu_indices(outputs)
    upper = jnp.zeros((outputs, outputs)).at[rows, columns].set(jax.vmap(second)(rows, columns))
    square = upper + upper.T - jnp.diag(jnp.diag(upper))
    return middle, square - jnp.outer(middle, middle), slope.T


def with_process_variance(process: Process, cov: Any) -> Any:
    """Return the covariance of :func:`moments` with what the process itself does not know."""
    return cov + jnp.diag(process.amplitudes**2)


def with_angle(mean: Any, cov: Any) -> tuple[Any, Any]:
    """Return mean and covariance of (p, θ, v, ω, sin θ, cos θ) at a Gaussian of the first four."""
    angle, variance = mean[1], cov[1, 1]
    shrunk = jnp.exp(-variance / 2)
    sine, cosine = shrunk * jnp.sin(angle), shrunk * jnp.cos(angle)
    twice = 0.5 * jnp.exp(-2 * variance)  # E of sin 2θ, cos 2θ, halved
    of_sine = 0.5 - twice * jnp.cos(2 * angle) - sine**2
    of_cosine = 0.5 + twice * jnp.cos(2 * angle) - cosine**2
    between = twice * jnp.sin(2 * angle) - sine * cosine
    across = jnp.stack([cov[1] * cosine, -cov[1] * sine])  # Stein's lemma
    own = jnp.array([[of_sine, between], [between, of_cosine]])
    return jnp.append(mean, jnp.array([sine, cosine])), jnp.block([[cov, across.T], [across, own]])


def saturated(mean: Any, variance: Any) -> tuple[Any, Any, Any]:
    """Return mean, variance and slope of F (9 sin x + sin 3x)/8, which saturates at ±F, of x ~ N(mean, variance)."""

    def wave(k: int, of: Callable[[Any], Any]) -> Any:
        return jnp.exp(-(k**2) * variance / 2) * of(k * mean)

    middle = (9 * wave(1, jnp.sin) + wave(3, jnp.sin)) / 8
    slope = (9 * wave(1, jnp.cos) + 3 * wave(3, jnp.cos)) / 8
    squares = 81 * (1 - wave(2, jnp.cos)) / 2 + 9 * (wave(2, jnp.cos) - wave(4, jnp.cos)) + (1 - wave(6, jnp.cos)) / 2
    return FORCE * middle, FORCE**2 * (squares / 64 - middle**2), FORCE * slope


class Policy(NamedTuple):
    """What a policy of radial basis functions is made of; it sees (p, v, ω, sin θ, cos θ).

    Its parameters are its values at the centres, which descend better than weights do.
    """

    centres: Any  # (b, 5)
    values: Any  # (b,)
    log_scales: Any  # (5,)

    def process(self) -> Process:
        """Return it as the mean of a Gaussian process."""
        count = len(self.values)
        scales = jnp.exp(self.log_scales)
        weights = jnp.linalg.solve(
            _kernel(self.centres, jnp.append(self.log_scales, jnp.array(_OF_VALUES))), self.values
        )
        return Process(self.centres, weights[None], jnp.zeros((1, count, count)), scales[None], jnp.ones(1))


SEEN = np.array([0, 2, 3, 4, 5])  # of (p, θ, v, ω, sin θ, cos θ), by the policy and, with the force, by the model


def step(model: Process, policy: Process, mean: Any, cov: Any) -> tuple[Any, Any]:
    """Return mean and covariance of the state a sample later, those of now given."""
    whole, spread = with_angle(mean, cov)
    seen, seen_cov = whole[SEEN], spread[jnp.ix_(SEEN, SEEN)]
    wish, wish_cov, wish_slope = moments(policy, seen, seen_cov)
    force, force_cov, force_slope = saturated(wish[0], wish_cov[0, 0])
    across = spread[:, SEEN] @ wish_slope[:, 0] * force_slope  # of the force with all six
    inputs = jnp.append(seen, force)
    inputs_cov = jnp.block([[seen_cov, across[SEEN][:, None]], [across[SEEN], force_cov]])
    change, change_cov, slope = moments(model, inputs, inputs_cov)
    known = jnp.concatenate([spread[:4, SEEN], across[:4, None]], axis=1)  # of the state with the model's inputs
    between = known @ slope
    after = cov + with_process_variance(model, change_cov) + between + between.T
    return mean + change, (after + after.T) / 2


def cost(mean: Any, cov: Any) -> Any:
    """Return E[1 - exp(-d²/2σ²)] of the tip's distance from upright above the track's middle."""
    whole, spread = with_angle(mean, cov)
    to_tip = jnp.array([[1.0, 0, 0, 0, LENGTH, 0], [0, 0, 0, 0, 0, LENGTH]])  # across and up; θ turns as sin θ does
    apart = to_tip @ whole - jnp.array([0.0, LENGTH])
    wide = to_tip @ spread @ to_tip.T + _WIDTH**2 * jnp.eye(2)
    return 1 - _WIDTH**2 / jnp.sqrt(jnp.linalg.det(wide)) * jnp.exp(-0.5 * apart @ jnp.linalg.solve(wide, apart))


def expected_cost(policy: Policy, model: Process) -> Any:
    """Return the expected cost of a trial, a sample's mean."""

    def forth(state: tuple[Any, Any], _: None) -> tuple[tuple[Any, Any], Any]:
        state = step(model, policy.process(), *state)
        return state, cost(*state)

    return jax.lax.scan(forth, _FIRST, length=SAMPLES)[1].mean()


def fit(inputs: Any, targets: Any) -> Process:
    """Return the Gaussian processes of greatest marginal likelihood, of no more than 500 times their noise."""
    size = inputs.shape[1]

    @jax.jit
    def surprise(log: Any, target: Any) -> Any:
        factor = jnp.linalg.cholesky(_kernel(inputs, log))
        solved = jax.scipy.linalg.solve_triangular(factor, target, lower=True)
        ratio = (log[-2] - log[-1]) / jnp.log(_GREATEST_RATIO)
        wide = (log[:size] - jnp.log(inputs.std(axis=0))) / jnp.log(100.0)
        return 0.5 * solved @ solved + jnp.log(jnp.diag(factor)).sum() + jnp.sum(wide**30) + ratio**30

    found = []
    for target in targets.T:
        first = np.log([*inputs.std(axis=0), target.std(), 0.1 * target.std()])
        found.append(minimize(jax.value_and_grad(surprise), first, (target,), jac=True, method="L-BFGS-B").x)
    logs = jnp.array(found)
    inverse = jax.vmap(lambda log: jnp.linalg.inv(_kernel(inputs, log)))(logs)
    weights = jnp.einsum("aij,ja->ai", inverse, targets)
    return Process(jnp.asarray(inputs), weights, inverse, jnp.exp(logs[:, :size]), jnp.exp(logs[:, size]))


def _kernel(inputs: Any, log: Any) -> Any:
    scaled = inputs * jnp.exp(-log[: inputs.shape[1]])
    squares = jnp.sum((scaled[:, None] - scaled) ** 2, axis=2)
    return jnp.exp(2 * log[-2] - 0.5 * squares) + jnp.exp(2 * log[-1]) * jnp.eye(len(inputs))


def improved(policy: Policy, model: Process, descents: int) -> Policy:
    """Return a policy after some steps down the gradient of the expected cost.

    Descended is -log(1 - cost), which has the same minimum: at first all but a 10⁵th of the cost is certain.
    """
    first, whole = ravel_pytree(policy)
    down = jax.jit(jax.value_and_grad(lambda flat: -jnp.log1p(-expected_cost(whole(flat), model))))
    return whole(jnp.asarray(minimize(down, first, jac=True, method="L-BFGS-B", options={"maxiter": descents}).x))


def law_of(policy: Policy) -> Callable[[float, np.ndarray], float]:
    """Return a policy as a controller of the rig, which sees all six measured numbers."""
    process, seen = policy.process(), np.array([0, 3, 4])
    centres, scales = np.asarray(process.inputs), np.asarray(process.scales[0])
    weights = np.asarray(process.weights[0])

    def law(_: float, x: np.ndarray) -> float:
        state = np.array([*x[seen], np.sin(x[1]), np.cos(x[1])])
        wish = weights @ np.exp(-0.5 * np.sum(((centres - state) / scales) ** 2, axis=1))
        return float(FORCE * (9 * np.sin(wish) + np.sin(3 * wish)) / 8)

    return law


def trial(law: Callable[[float, np.ndarray], float], rng: np.random.Generator) -> dpend.Run:
    """Return four seconds from hanging, give or take .1 of all that a state of the cart-pole has."""
    x0 = HANGING + 0.1 * rng.standard_normal(6) * [1, 1, 0, 1, 1, 0]
    return dpend.simulate(RIG, law, x0, SECONDS, task=None, seed=int(rng.integers(2**31)))


def transitions(run: dpend.Run) -> tuple[np.ndarray, np.ndarray]:
    """Return what a model learns from: inputs ``(n, 6)`` and the change of (p, θ, v, ω) ``(n, 4)``."""
    states = run.y[:, [0, 1, 3, 4]]
    seen = np.column_stack([states[:, [0, 2, 3]], np.sin(states[:, 1]), np.cos(states[:, 1])])
    return np.column_stack([seen[:-1], run.u]), np.diff(states, axis=0)


def stands(run: dpend.Run) -> bool:
    """Return whether over a trial's last second the tip was within .1 m of upright, and the cart within .5 m."""
    x = run.x[-1 - round(1.0 / RIG.sample_time) :]
    tip = np.hypot(LENGTH * np.sin(x[:, 1]), LENGTH * (1 - np.cos(x[:, 1])))
    return bool((tip < 0.1).all() and (np.abs(x[:, 0]) < 0.5).all())


def learn(options: Options) -> Iterator[tuple[Policy, dpend.Run]]:
    """Yield after each trial the policy and the trial: random forces, a model, a policy, a trial with it, and again."""
    rng = np.random.default_rng(options.seed)
    runs = [trial(lambda t, x: float(rng.uniform(-FORCE, FORCE)), rng)]
    policy = Policy(
        centres=jnp.asarray(0.1 * rng.standard_normal((options.basis, 5)) + [0, 0, 0, 0, -1]),
        values=jnp.asarray(0.1 * rng.standard_normal(options.basis)),
        log_scales=jnp.log(jnp.array([1.0, 1.0, 1.0, 0.7, 0.7])),
    )
    for _ in range(options.trials):
        inputs, targets = map(np.concatenate, zip(*map(transitions, runs), strict=True))
        policy = improved(policy, fit(inputs, targets), options.descents)
        runs.append(trial(law_of(policy), rng))
        yield policy, runs[-1]


def main(arguments: list[str] | None = None) -> None:
    """Learn, and say after each trial whether it stood, and what it has cost."""
    options = tyro.cli(Options, description=__doc__, args=arguments)
    began, ups = time.process_time(), 0
    for number, (_, run) in enumerate(learn(options), 1):
        ups += stands(run)
        print(
            f"trial {number:2}: {'stands' if stands(run) else 'falls '} after {SECONDS * (number + 1):4.0f} s of "
            f"experience, {time.process_time() - began:5.0f} s of processor time",
            flush=True,
        )
    print(f"{ups} of {options.trials} trials stood for their last second.")


if __name__ == "__main__":
    main()
