"""One smooth piece of a profile, between two events."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import cos, inf, sin
from typing import NamedTuple

__all__ = ["Segment", "joined"]


class Segment(NamedTuple):
    """A profile on [start, end], between two events: one smooth formula.

    ``held + slope (t - start) + Σ a sin(ω t + φ) + Σ a sin((ω + κ t) t + φ)``

    Attributes
    ----------
    start, end : float
        The last event at or before the time asked for, and the next one strictly after it; s.
        -inf and inf if there is none.
    held : float
        Sum of the constant and piecewise constant parts (of a linear table: its value at `start`).
    smooth : tuple of (float, float, float)
        (a, ω, φ) of each sine.
    slope : float
        Slope of the linear tables; 0 where `start` is -inf.
    chirps : tuple of (float, float, float, float)
        (a, ω, κ, φ) of each chirp in its sweep.
    """

    start: float
    end: float
    held: float = 0.0
    smooth: tuple[tuple[float, float, float], ...] = ()
    slope: float = 0.0
    chirps: tuple[tuple[float, float, float, float], ...] = ()

    def value(self, t: float) -> float:
        """Value of this piece at `t`; at `end`, the limit from the left."""
        total = self.held
        for a, w, p in self.smooth:
            total += a * sin(w * t + p)
        if self.slope:
            total += self.slope * (t - self.start)
        if self.chirps:
            for a, w, k, p in self.chirps:
                total += a * sin((w + k * t) * t + p)
        return total

    def formula(self) -> Callable[[float], float]:
        """`value` as a function of time alone, to the bit, for where it is evaluated often."""
        held, smooth = self.held, self.smooth
        if self.slope or self.chirps or len(smooth) > 2:
            return self.value
        if not smooth:
            return lambda t: held
        (a, w, p), *more = smooth
        if not more:
            return lambda t: held + a * sin(w * t + p)
        ((b, v, q),) = more
        return lambda t: held + a * sin(w * t + p) + b * sin(v * t + q)

    def derivative(self, t: float) -> float:
        """Derivative of this piece at `t`, 1/s times the unit of the value."""
        total = self.slope
        for a, w, p in self.smooth:
            total += a * w * cos(w * t + p)
        for a, w, k, p in self.chirps:
            total += a * (w + 2.0 * k * t) * cos((w + k * t) * t + p)
        return total


def joined(fixed: Segment, pieces: Sequence[Segment], start: float) -> Segment:
    """The sum of `fixed`, which holds at all times, and `pieces`, from `start` to the first end."""
    end, held, smooth, slope, chirps = inf, fixed.held, fixed.smooth, 0.0, fixed.chirps
    for piece in pieces:
        end = min(end, piece.end)
        held += piece.held
        if piece.slope:
            held += piece.slope * (start - piece.start)
            slope += piece.slope
        smooth += piece.smooth
        chirps += piece.chirps
    return Segment(start, end, held, smooth, slope, chirps)
