"""Blocks that stand beside a plant and its controller: what drives them, and what lies between."""

from __future__ import annotations

from math import comb

import casadi as ca

from congelation.errors import InvalidInput
from congelation.theory.model import (
    Domain,
    Model,
    Output,
    Parameter,
    Signals,
    State,
    Variables,
    scalar,
    vector,
)

__all__ = ["reference"]


def reference(n: int, sines: int = 2) -> Model:
    """A reference y_r(t) with its derivatives up to order n, for a controller that tracks it.

    y_r = offset + sum_i a_i sin(omega_i t + phi_i) + q_0, where q_0 is what the filter

        (d/dt + bandwidth)^(n+1) q_0 = bandwidth^(n+1) r

    makes of the signal r(t). Its n + 1 states are q_0 and its derivatives up to order n, so all of
    y_r, .., y_r^(n) are continuous where r jumps, and the derivative of y_r^(n) is exact, too.

    Parameters
    ----------
    n : int
        Highest derivative that is put out, ``yr[n]``.
    sines : int
        Number of sines, which pass the filter by: there are no transients of them.

    Raises
    ------
    InvalidInput
        A negative number.
    """
    if n < 0 or sines < 0:
        raise InvalidInput(f"n = {n}, sines = {sines} are not valid; give numbers from 0 on")
    q = Variables(
        "q", ca.SX.sym("q", n + 1), "State of the filter: q_0 and its derivatives", "", True, 0
    )
    r = Signals.of(scalar("r", "Signal r(t) before the filter"))
    offset = scalar("offset", "Constant part of the reference")
    bandwidth = scalar("bandwidth", "Rate of the filter that r(t) passes", "rad/s")
    parameters = [
        Parameter(offset, (0.0,)),
        Parameter(bandwidth, (1.0,), Domain.POSITIVE),
    ]
    direct = offset.symbol
    if sines:
        a = vector("amplitude", sines, "Amplitude of a sine of the reference")
        omega = vector("omega", sines, "Angular frequency of a sine of the reference", "rad/s")
        phi = vector("phase", sines, "Phase of a sine of the reference at t = 0", "rad")
        parameters += [
            Parameter(a, (0.0,) * sines),
            Parameter(omega, (1.0,) * sines),
            Parameter(phi, (0.0,) * sines),
        ]
        direct += ca.dot(a.symbol, ca.sin(omega.symbol * r.time + phi.symbol))

    # (d/dt + w)^(n+1), expanded: the coefficient of the k-th derivative.
    w, order = bandwidth.symbol, n + 1
    highest = w**order * (r.variables.symbol - q.symbol[0])
    for k in range(1, order):
        highest -= comb(order, k) * w ** (order - k) * q.symbol[k]
    derivatives = [direct]
    for _ in range(n):
        derivatives.append(ca.jacobian(derivatives[-1], r.time))
    y_r = Variables(
        "yr", q.symbol + ca.vertcat(*derivatives), "Reference y_r and its derivatives", "", True, 0
    )
    return Model(
        name="Reference",
        description=f"Reference y_r(t) with its derivatives up to order {n}",
        inputs=(),
        states=(State(q, ca.vertcat(q.symbol[1:], highest), (0.0,) * order),),
        parameters=tuple(parameters),
        outputs=(Output(y_r, differentiated=True), Output(r.variables)),
        signals=r,
    )
