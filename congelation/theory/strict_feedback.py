"""Plants in parametric strict-feedback form (9)."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from congelation.errors import InvalidInput
from congelation.theory.gains import upper_shift
from congelation.theory.model import Input, Model, Output, State, scalar, vector

__all__ = ["SYSTEM_60", "checked_phibar", "regressors", "strict_feedback_plant"]

SYSTEM_60 = (((-1.0, 0.0), (0.0, 0.0)), ((0.0, -1.0), (0.0, 0.0)))
"""phibar of the system (60) of Sec. V: x_1' = -theta_1 x_1 + x_2, x_2' = -theta_2 x_1 + u."""


def checked_phibar(phibar: ArrayLike) -> NDArray[np.float64]:
    """phibar as an array of shape (n, n, p), refused if it is not lower block triangular.

    Parameters
    ----------
    phibar : array_like, shape (n, n, p)
        phibar[i-1, j-1] is the vector phibar_{i,j} of (10), zero for j > i.
    """
    array = np.asarray(phibar, dtype=float)
    if array.ndim != 3 or array.shape[0] != array.shape[1] or 0 in array.shape:
        raise InvalidInput(f"phibar has shape {array.shape}; valid: (n, n, p) with n, p >= 1")
    if not np.isfinite(array).all():
        raise InvalidInput("phibar has an element that is not finite; valid: finite numbers")
    above = np.argwhere(array.any(axis=2) & ~np.tri(len(array), dtype=bool))
    if above.size:
        i, j = above[0] + 1
        raise InvalidInput(
            f"phibar_{{{i},{j}}} is not zero; valid: zero above the diagonal, because row i of the "
            "strict-feedback form (9) holds x_1 .. x_i only"
        )
    return array


def regressors(phibar: NDArray[np.float64], x: ca.SX) -> list[ca.SX]:
    """phi_1(x_1) .. phi_n(x), each of shape (p, 1): phi_i = sum_{j<=i} phibar_{i,j} x_j, (10)."""
    return [ca.DM(row[: i + 1].T) @ x[: i + 1] for i, row in enumerate(phibar)]


def strict_feedback_plant(phibar: ArrayLike = SYSTEM_60) -> Model:
    """The plant (9), x' = S x + Phi^T(x) theta + e_n u, for any n and p.

    Parameters
    ----------
    phibar : array_like, shape (n, n, p)
        See `checked_phibar`.
    """
    checked = checked_phibar(phibar)
    n, _, p = checked.shape
    x = vector("x", n, "State x of (9)")
    u = scalar("u", "Input u of (9)")
    theta = vector("theta", p, "Unknown parameters theta(t) of (9)")
    Phi = ca.horzcat(*regressors(checked, x.symbol))
    e_n = ca.DM(np.eye(n)[:, -1:])
    rate = ca.DM(upper_shift(n)) @ x.symbol + Phi.T @ theta.symbol + e_n @ u.symbol
    return Model(
        name="StrictFeedbackPlant",
        description=f"Plant (9) in parametric strict-feedback form, n = {n}, p = {p}",
        inputs=(Input.of(u),),
        states=(State(x, rate, start=(1.0,) + (0.0,) * (n - 1)),),
        parameters=(),
        outputs=(Output(x, differentiated=True),),
        theta=theta,
    )
