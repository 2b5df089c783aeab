"""Blocks that stand beside a plant and its controller: what drives them, and what lies between."""

from __future__ import annotations

from math import comb

import casadi as ca

from congelation.errors import InvalidInput
from congelation.theory.model import (
    Domain,
    Input,
    Model,
    Output,
    Parameter,
    Signals,
    State,
    Variables,
    scalar,
    vector,
)

__all__ = ["delay", "disturbance", "lag", "noise", "reference", "saturation"]


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


def disturbance(size: int) -> Model:
    """Signals d_1(t) .. d_size(t) from profiles, with their exact derivatives."""
    d = Signals.of(vector("d", _checked(size), "Disturbance d(t)"))
    return Model(
        name="Disturbance",
        description="Disturbance d(t) from profiles",
        inputs=(),
        states=(),
        parameters=(),
        outputs=(Output(d.variables, differentiated=True),),
        signals=d,
    )


def noise(size: int) -> Model:
    """y = u + n(t), n being sampled random numbers: between two samples y moves as u does."""
    u, n = _input(size), Signals.of(vector("n", size, "Noise n(t), held between its samples"))
    return Model(
        name="Noise",
        description="Measurement noise: y = u + n(t), n(t) held between its samples",
        inputs=(u,),
        states=(),
        parameters=(),
        outputs=(_output(u.variables.symbol + n.variables.symbol, "u + n"), Output(n.variables)),
        signals=n,
    )


def saturation(size: int) -> Model:
    """y = centre + max(-limit, min(limit, u - centre)), element by element.

    y is smooth but where u meets a limit; its derivative there is that of the piece inside.
    """
    u = _input(size)
    limit = vector("limit", size, "Largest |y - centre|")
    centre = vector("centre", size, "Middle of the range of y")
    inner = u.variables.symbol - centre.symbol
    y = centre.symbol + ca.fmax(-limit.symbol, ca.fmin(limit.symbol, inner))
    side = (inner > limit.symbol) - (inner < -limit.symbol)
    return Model(
        name="Saturation",
        description="Saturation of an actuator: y = u, but no further than limit from centre",
        inputs=(u,),
        states=(),
        parameters=(
            Parameter(limit, (1.0,) * size, Domain.POSITIVE),
            Parameter(centre, (0.0,) * size),
        ),
        outputs=(
            _output(y, "u within the limits"),
            Output(Variables("saturated", side, "-1, 0 or 1: below, within or above the limits")),
        ),
    )


def lag(size: int) -> Model:
    """T y' = gain u - y, element by element."""
    u, y = _input(size), vector("y", size, "Output y: gain u behind a lag of first order")
    T = vector("T", size, "Time constant of the lag", "s")
    gain = vector("gain", size, "Gain at rest")
    rate = (gain.symbol * u.variables.symbol - y.symbol) / T.symbol
    return Model(
        name="Lag",
        description="Lag of an actuator or sensor: T y' = gain u - y",
        inputs=(u,),
        states=(State(y, rate, (0.0,) * size),),
        parameters=(
            Parameter(T, (0.1,) * size, Domain.POSITIVE),
            Parameter(gain, (1.0,) * size),
        ),
        outputs=(Output(y, differentiated=True),),
    )


def delay(size: int) -> Model:
    """y(t) = u(t - delay); y = before until the first input comes out.

    The delayed input and its slope are signals that the FMU finds in its memory of the input.
    """
    u, w = _input(size), Signals.of(vector("w", size, "Input u(t - delay)"), profiled=False)
    T = scalar("delay", "Time from input to output", "s")
    before = vector("before", size, "Output until the first input comes out")
    return Model(
        name="Delay",
        description="Delay: y(t) = u(t - delay)",
        inputs=(u,),
        states=(),
        parameters=(
            Parameter(T, (0.1,), Domain.POSITIVE),
            Parameter(before, (0.0,) * size),
        ),
        outputs=(_output(w.variables.symbol, "u(t - delay)"),),
        signals=w,
    )


def _checked(size: int) -> int:
    if size < 1:
        raise InvalidInput(f"size = {size} is not valid; give a number from 1 on")
    return size


def _input(size: int) -> Input:
    return Input.of(vector("u", _checked(size), "Input u"))


def _output(y: ca.SX, formula: str) -> Output:
    return Output(Variables("y", y, f"Output y = {formula}"), differentiated=True)
