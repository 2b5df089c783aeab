"""Random systems, designs and states for the tests of the theory, and numbers of expressions."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np
from hypothesis import strategies as st

from congelation.theory.iss_riccati import iss_weight, smallest_feasible_r
from congelation.theory.model import Model

seeds = st.integers(min_value=0, max_value=2**32 - 1)
orders = st.sampled_from(
    [(1, 1), (1, 3), (2, 1), (2, 2), (2, 3), (3, 1), (3, 2), (3, 3), (4, 2), (4, 3)]
)
"""(n, p) of strict-feedback plants."""
degrees = st.sampled_from([(n, m) for n in (1, 2, 3, 4) for m in range(n)])
"""(n, m) of observer-form plants."""


@functools.cache
def least_r(n: int, epsilon: float) -> float:
    """The smallest feasible r for constant b, once for each filter."""
    return smallest_feasible_r(n, iss_weight(n, epsilon))


def random_phibar(rng: np.random.Generator, n: int, p: int) -> np.ndarray:
    """Lower block triangular, every block full."""
    return rng.normal(size=(n, n, p)) * np.tri(n)[:, :, None]


def random_definite(rng: np.random.Generator, n: int) -> np.ndarray:
    """A full symmetric positive definite matrix."""
    factor = rng.normal(size=(n, n))
    return factor @ factor.T + 0.1 * np.eye(n)


def random_state_feedback_parameters(
    rng: np.random.Generator, n: int, p: int
) -> dict[str, np.ndarray | float]:
    return {
        "c": rng.uniform(0.1, 2, n),
        "Gamma": random_definite(rng, p),
        "epsilon": rng.uniform(0.3, 2),
        "delta": rng.uniform(0, 3),
        "damping": 1.0,
    }


def random_output_feedback_parameters(
    rng: np.random.Generator, n: int, m: int
) -> dict[str, np.ndarray | float]:
    rho, q = n - m, n + m + 1
    epsilon = float(rng.choice([0.3, 0.7, 1.0, 2.0]))
    delta = rng.uniform(0.1, 3)
    return {
        "c": rng.uniform(0.1, 2, rho),
        "d": rng.uniform(0.1, 2, rho),
        "Gamma": random_definite(rng, q),
        "gamma": rng.uniform(0.1, 3),
        "r": least_r(n, epsilon) * rng.uniform(1.05, 3),
        "epsilon": epsilon,
        "delta": delta,
        "delta_1": delta * rng.uniform(0, 1),
        "damping": 1.0,
        "corrected": 1.0,
        "sign_b_m": float(rng.choice([-1, 1])),
    }


def random_state(
    rng: np.random.Generator, model: Model, scale: float = 0.5
) -> dict[str, np.ndarray]:
    """Values of the states and inputs of a model."""
    variables = [s.variables for s in model.states] + [i.variables for i in model.inputs]
    return {v.name: scale * rng.normal(size=v.shape) for v in variables}


def numbers(
    model: Model, expressions: Sequence[ca.SX], values: Mapping[str, object]
) -> list[np.ndarray]:
    """`expressions` at `values`; every symbol must have one, so that none is 0 by accident."""
    named = model.arguments()
    missing = {n for n in named if not n.startswith("der(")} - set(values)
    assert not missing, f"no value for {missing}"
    return model.evaluate(expressions, values)


def relative_difference(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference, relative to the largest element."""
    scale = max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0), 1e-300)
    return float(np.abs(a - b).max(initial=0.0) / scale)
