"""From a transfer function with intervals for its coefficients to a spec (`new --from`).

    numerator = [1, [0.8, 1.2]]                   # b_m .. b_0
    denominator = [1, [0.5, 1.5], [-1, 0], 0.2]   # 1, a_(n-1) .. a_0

is y = (b_m s^m + .. + b_0)/(s^n + a_(n-1) s^(n-1) + .. + a_0) u, the plant (27) in output feedback.
In its interval a coefficient of the denominator varies as fast as it likes; one of the numerator is
a constant that is not known. The radii and the centre follow from the intervals.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from congelation import keys
from congelation.errors import InvalidInput, shown
from congelation.theory.iss_riccati import iss_weight, smallest_feasible_r
from congelation.toml import read_document

__all__ = ["TransferFunction", "marks", "transfer_function"]

Interval = tuple[float, float]

RESERVE = 1.25
"""r of the K-filter over the smallest feasible one: near that, its gains grow without bound."""

PERIODS = (1.3, 2.1, 0.7, 3.1, 1.7, 0.9)
"""Periods in seconds of the square waves in which the coefficients of the profile jump between the
ends of their intervals; unrelated, so that all corners of the box occur. A starting point to be
changed."""


@dataclass(frozen=True)
class TransferFunction:
    """b(s)/a(s) with an interval for each coefficient, a monic: b_m .. b_0 and a_{n-1} .. a_0."""

    b: tuple[Interval, ...]
    a: tuple[Interval, ...]

    @property
    def n(self) -> int:
        return len(self.a)

    @property
    def m(self) -> int:
        return len(self.b) - 1

    @property
    def delta(self) -> float:
        """Radius of the box of a(t)."""
        return math.sqrt(sum(((high - low) / 2) ** 2 for low, high in self.a))

    @property
    def delta_1(self) -> float:
        """Radius of a_{n-1}(t)."""
        low, high = self.a[0]
        return (high - low) / 2


def transfer_function(source: Any, spread: float = 0.0) -> TransferFunction:
    """The transfer function that a file or a python-control system describes, checked.

    Parameters
    ----------
    source : Path, str, mapping or control.lti.LTI
        A TOML file with `numerator` and `denominator`, a mapping of the same, or a continuous
        system of python-control with one input and one output.
    spread : float
        Half the width of the interval of each coefficient of the denominator that is given as a
        number, relative to the number; those that are 0 stay so.

    Raises
    ------
    InvalidInput
        Naming the coefficient, and what an assumption of the theorem asks of it.
    """
    if not 0.0 <= spread < math.inf:
        raise InvalidInput(f"spread = {shown(spread)} is not valid; give a number from 0 on")
    if isinstance(source, str | Path):
        _, top = read_document(Path(source))
        read = top.read(keys.TRANSFER)
        place, numerator, denominator = f"{source}: ", read["numerator"], read["denominator"]
    elif isinstance(source, Mapping):
        unknown = sorted(set(source) - {"numerator", "denominator"})
        if unknown or len(source) != 2:
            raise InvalidInput("give numerator and denominator, and no other keys")
        place, numerator, denominator = "", source["numerator"], source["denominator"]
    else:
        place, (numerator, denominator) = "", _of_control(source)
    b = _intervals(numerator, f"{place}numerator")
    a = _intervals(denominator, f"{place}denominator")
    lead = a[0]
    if lead[0] != lead[1] or lead[0] == 0.0:
        raise InvalidInput(
            f"{place}denominator[1] = {_shown(lead)} is not valid; give the coefficient of the "
            "highest power as a number that is not 0 (divide by it where it varies)"
        )
    while len(b) > 1 and b[0] == (0.0, 0.0):
        b = b[1:]
    if b[0][0] <= 0.0 <= b[0][1]:
        raise InvalidInput(
            f"{place}numerator: {_shown(b[0])} is not valid for its highest power: the sign of b_m "
            "has to be known (Assumption 3); give a number or an interval without 0"
        )
    b = [_over(interval, lead[0]) for interval in b]
    a = [_over(interval, lead[0]) for interval in a[1:]]
    if len(b) > len(a):
        raise InvalidInput(
            f"{place}numerator is of degree {len(b) - 1}, the denominator of {len(a)}; give a "
            "plant with fewer zeros than poles, as (27) has"
        )
    _check_hurwitz(b, place)
    spread_a = [_widened(interval, spread) for interval in a]
    return TransferFunction(tuple(b), tuple(spread_a))


def _of_control(system: Any) -> tuple[Sequence[float], Sequence[float]]:
    """Numerator and denominator of a python-control system."""
    try:
        import control
    except ModuleNotFoundError:
        raise InvalidInput(
            f"{shown(system)} is no file and no mapping; give one, or, for a system of "
            "python-control, install that: pip install congelation[control]"
        ) from None
    if not isinstance(system, control.StateSpace | control.TransferFunction):
        raise InvalidInput(f"{shown(system)} is no system; give a TransferFunction or StateSpace")
    if system.ninputs != 1 or system.noutputs != 1:
        raise InvalidInput(
            f"the system has {system.ninputs} inputs and {system.noutputs} outputs; "
            "give one of each"
        )
    if system.isdtime(strict=True):
        raise InvalidInput(
            f"the system is of discrete time, dt = {system.dt}; give one of continuous time"
        )
    # A realisation that is not minimal would hide zeros and poles that cancel.
    found = control.minreal(control.tf(system), verbose=False)
    return [float(v) for v in found.num[0][0]], [float(v) for v in found.den[0][0]]


def _intervals(values: Any, place: str) -> list[Interval]:
    if not isinstance(values, Sequence | np.ndarray) or len(values) == 0:
        raise InvalidInput(f"{place} is not valid; give an array of numbers and [low, high]")
    found = []
    for k, value in enumerate(values, 1):
        pair = [value, value] if np.ndim(value) == 0 else list(value)
        try:
            low, high = (float(v) for v in pair)
        except (TypeError, ValueError, OverflowError):
            low, high = math.nan, math.nan
        if isinstance(value, bool) or not -math.inf < low <= high < math.inf:
            raise InvalidInput(
                f"{place}[{k}] = {shown(value)} is not valid; give a number, or [low, high]"
            )
        found.append((low, high))
    return found


def _over(interval: Interval, lead: float) -> Interval:
    low, high = sorted(end / lead for end in interval)
    return low, high


def _widened(interval: Interval, spread: float) -> Interval:
    low, high = interval
    return interval if low < high else (low - spread * abs(low), high + spread * abs(high))


def _check_hurwitz(b: Sequence[Interval], place: str) -> None:
    """Refuse a numerator that is not Hurwitz for some constants in its intervals (Assumption 2).

    V. L. Kharitonov, Differential Equations 14 (1979) 1483-1485: all are Hurwitz if and only if
    four of them are, whose coefficients from b_0 on are low, low, high, high, .. and its shifts.
    """
    rising = list(reversed(b))  # b_0 .. b_m
    for shift in range(4):
        ends = [interval[((k + shift) // 2) % 2] for k, interval in enumerate(rising)]
        zeros = np.roots(ends[::-1])
        if zeros.size and zeros.real.max() >= 0.0:
            worst = zeros[np.argmax(zeros.real)]
            b_shown = ", ".join(f"{end:.6g}" for end in ends[::-1])
            raise InvalidInput(
                f"{place}numerator: with b = [{b_shown}] the plant has a zero at {worst:.4g}; give "
                "intervals with which every b is Hurwitz (Assumption 2)"
            )


def _shown(interval: Interval) -> str:
    low, high = interval
    return f"{low:g}" if low == high else f"[{low:g}, {high:g}]"


def marks(found: TransferFunction) -> dict[str, str]:
    """What the templates of a plant in output feedback leave open, by mark."""
    n, m, rho = found.n, found.m, found.n - found.m
    r = RESERVE * smallest_feasible_r(n, iss_weight(n, 1.0))
    names = [f"b_{j}" for j in range(m, -1, -1)] + [f"a_{j}" for j in range(n - 1, -1, -1)]
    profile = []
    for j, (low, high) in enumerate([*found.b, *found.a]):
        middle, half = (low + high) / 2, (high - low) / 2
        terms = [f"{{constant = {middle:.12g}}}"]
        note = f"{names[j]} = {_shown((low, high))}"
        if half and j <= m:
            note = f"{names[j]} in [{low:g}, {high:g}], constant and not known"
        elif half:
            note = f"{names[j]}(t) in [{low:g}, {high:g}]"
            period = PERIODS[(j - m - 1) % len(PERIODS)]
            terms.append(f"{{square = {{amplitude = {half:.12g}, period = {period}}}}}")
        profile.append(f'"theta[{j + 1}]" = [{", ".join(terms)}]   # {note}')
    return {
        "@N@": str(n),
        "@M@": str(m),
        "@PROFILE@": "\n".join(profile),
        "@X0@": str([1.0] + [0.0] * (n - 1)),
        "@C@": str([1.0] * rho),
        "@D@": str([0.5] * rho),
        "@R@": f"{r:.4g}",
        "@DELTA@": _up(found.delta),
        "@DELTA_1@": _up(found.delta_1),
        "@SIGN@": f"{math.copysign(1.0, found.b[0][0]):g}",
    }


def _up(value: float) -> str:
    """`value` in six digits, not rounded down: the radius of a box has to hold the box."""
    if value == 0.0:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(value)) - 5)
    return f"{math.ceil(value / unit - 1e-6) * unit:.6g}"
