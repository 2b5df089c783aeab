"""Plants in observable canonical form (27)."""

from __future__ import annotations

import casadi as ca
import numpy as np

from congelation.errors import InvalidInput
from congelation.theory.matrices import upper_shift
from congelation.theory.model import Input, Model, Output, State, Variables, scalar, vector
from congelation.theory.options import disturbance as disturbance_of

__all__ = ["checked_orders", "observer_form_plant", "parameter_regressor"]


def checked_orders(n: int, m: int) -> int:
    """The relative degree rho = n - m, if 0 <= m <= n - 1."""
    if n < 1 or not 0 <= m <= n - 1:
        raise InvalidInput(f"n = {n}, m = {m}; valid: n >= 1 and 0 <= m <= n - 1")
    return n - m


def parameter_regressor(n: int, m: int, y: ca.SX, u: ca.SX) -> ca.SX:
    """F^T(y, u) of (27), shape (n, m + 1 + n): [[0; I_{m+1}] u, -I_n y]."""
    rho = checked_orders(n, m)
    inputs = ca.DM(np.vstack([np.zeros((rho - 1, m + 1)), np.eye(m + 1)]))
    return ca.horzcat(inputs * u, -ca.SX.eye(n) * y)


def observer_form_plant(n: int = 2, m: int = 0, disturbance: bool = False) -> Model:
    """The plant (27), x' = S x + F^T(y, u) theta, y = x_1.

    Parameters
    ----------
    n, m : int
        Order, and degree of the numerator: theta = [b_m .. b_0, a_{n-1} .. a_0].
    disturbance : bool
        With the input d, x' = .. + d.
    """
    checked_orders(n, m)
    x = vector("x", n, "State x of (27)")
    u = scalar("u", "Input u of (27)")
    theta = vector("theta", m + 1 + n, "Parameters [b_m .. b_0, a_(n-1)(t) .. a_0(t)] of (27)")
    y = x.symbol[0]
    F_T = parameter_regressor(n, m, y, u.symbol)
    rate = ca.DM(upper_shift(n)) @ x.symbol + F_T @ theta.symbol
    inputs = [Input.of(u)]
    if disturbance:
        d = disturbance_of(n)
        inputs.append(Input.of(d, "disturbance"))
        rate += d.symbol
    about = "disturbed, " if disturbance else ""
    return Model(
        name="ObserverFormPlant",
        description=f"Plant (27) in observable canonical form, {about}n = {n}, m = {m}",
        inputs=tuple(inputs),
        states=(State(x, rate, start=(1.0,) + (0.0,) * (n - 1)),),
        parameters=(),
        outputs=(
            Output(
                Variables("y", ca.SX(y), "Output y = x_1 of (27)", indexed=False),
                differentiated=True,
            ),
            Output(x),
        ),
        theta=theta,
    )
