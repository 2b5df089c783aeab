"""Plants under the matching condition: the remark after (8), worked out for any n.

The plant is x' = A x + B (u + theta(t)^T x) with (A, B) known, one input, theta(t) in R^n. With
V = x^T P x + (ell - theta_hat)^T Gamma^-1 (ell - theta_hat) the congealed perturbation leaves
2 x^T P B Delta^T x, which the Riccati equation of `matched_riccati` absorbs, so that
V' <= -x^T Q x for every |Delta| <= delta.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from congelation.errors import InvalidInput
from congelation.theory.adaptation import AdaptationFactory, gradient
from congelation.theory.model import (
    Domain,
    Gain,
    Input,
    Model,
    Output,
    Parameter,
    State,
    control,
    matrix,
    scalar,
    vector,
)

__all__ = ["DOUBLE_INTEGRATOR", "checked_pair", "matched_controller", "matched_plant"]

DOUBLE_INTEGRATOR = (((0.0, 1.0), (0.0, 0.0)), (0.0, 1.0))
"""(A, B) of x_1'' = u + theta(t)^T x, the default plant."""

Pair = tuple[NDArray[np.float64], NDArray[np.float64]]


def checked_pair(A: ArrayLike, B: ArrayLike) -> Pair:
    """(A, B) as arrays of shapes (n, n) and (n, 1), refused if not finite or not fitting."""
    state, column = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
    if state.ndim != 2 or state.shape[0] != state.shape[1] or state.size == 0:
        raise InvalidInput(f"A has shape {state.shape}; valid: (n, n) with n >= 1")
    n = state.shape[0]
    if column.shape not in {(n,), (n, 1)}:
        raise InvalidInput(f"B has shape {column.shape}; valid: ({n},), one input")
    if not (np.isfinite(state).all() and np.isfinite(column).all()):
        raise InvalidInput("A or B has an element that is not finite; valid: finite numbers")
    return state, column.reshape(n, 1)


def matched_plant(
    A: ArrayLike = DOUBLE_INTEGRATOR[0], B: ArrayLike = DOUBLE_INTEGRATOR[1]
) -> Model:
    """The plant x' = A x + B (u + theta(t)^T x).

    Parameters
    ----------
    A, B : array_like, shapes (n, n), (n,)
        Known.
    """
    state, column = checked_pair(A, B)
    n = state.shape[0]
    x = vector("x", n, "State x of the matched plant")
    u = scalar("u", "Input u of the matched plant")
    theta = vector("theta", n, "Unknown parameters theta(t), matched by the input")
    rate = ca.DM(state) @ x.symbol + ca.DM(column) @ (u.symbol + theta.symbol.T @ x.symbol)
    return Model(
        name="MatchedPlant",
        description=f"Plant x' = A x + B (u + theta(t)^T x) under the matching condition, n = {n}",
        inputs=(Input.of(u),),
        states=(State(x, rate, start=(1.0,) + (0.0,) * (n - 1)),),
        parameters=(),
        outputs=(Output(x, differentiated=True),),
        theta=theta,
    )


def matched_controller(
    A: ArrayLike = DOUBLE_INTEGRATOR[0],
    B: ArrayLike = DOUBLE_INTEGRATOR[1],
    adaptation: AdaptationFactory = gradient,
) -> Model:
    """u = -theta_hat^T x - (rho/2) B^T P x, theta_hat' = Gamma x (B^T P x).

    Parameters
    ----------
    A, B : array_like
        See `matched_plant`.
    adaptation : callable
        The law of the estimates, see `congelation.theory.adaptation`.
    """
    state, column = checked_pair(A, B)
    n = state.shape[0]
    x = vector("x", n, "State x of the matched plant")
    theta_hat = vector("theta_hat", n, "Estimate of theta")
    Gamma = matrix("Gamma", n, n, "Adaptation gain")
    rho = scalar("rho", "Weight of the feedback -(rho/2) B^T P x; above 1/epsilon^2")
    Q = matrix("Q", n, n, "Rate of decay left in V': V' <= -x^T Q x")
    epsilon = scalar("epsilon", "Weight in Young's inequality")
    delta = scalar("delta", "Radius of theta(t), Assumption 1")
    damping = scalar("damping", "True: Controller 1, with damping; false: Controller 2")
    P = matrix("P", n, n, "Solution of the Riccati equation that stands for (8)")
    law = adaptation(theta_hat, Gamma.symbol, 0)

    e = ca.DM(column).T @ P.symbol @ x.symbol
    tau = law.regressor(x.symbol, e) * e
    u = -theta_hat.symbol.T @ x.symbol - rho.symbol / 2 * e
    return Model(
        name="MatchedController",
        description=f"Adaptive controller for the matched plant, n = {n}",
        inputs=(Input.of(x),),
        states=(State(theta_hat, Gamma.symbol @ law.rate(tau), start=(0.0,) * n),),
        parameters=(
            Parameter(Gamma, tuple(np.eye(n).ravel()), Domain.POSITIVE_DEFINITE),
            Parameter(rho, (2.0,), Domain.POSITIVE),
            Parameter(Q, tuple(np.eye(n).ravel()), Domain.POSITIVE_DEFINITE),
            Parameter(epsilon, (1.0,), Domain.POSITIVE),
            Parameter(delta, (1.0,), Domain.NONNEGATIVE),
            Parameter(damping, (1.0,), Domain.BOOLEAN),
            *law.parameters,
        ),
        gains=(
            Gain(
                P,
                "matched_riccati",
                ("rho", "epsilon", "delta", "damping", "Q"),
                {"A": _nested(state), "B": _nested(column)},
            ),
        ),
        outputs=(
            control(u, "Control u"),
            Output(theta_hat),
        ),
    )


def _nested(array: NDArray[np.float64]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(v) for v in row) for row in array)
