"""The terms that formulas give: constants, sines, squares and chirps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from math import floor, inf, pi, sin
from typing import ClassVar

from .checks import ProfileError, checked, number_field
from .segment import Segment

__all__ = ["Chirp", "Constant", "ScalarTerm", "Sine", "Square", "Term"]

# Half periods beyond this many cannot be told apart in double precision (53 bits, two to spare).
MAX_HALF_PERIODS = 2.0**51


class Term(ABC):
    """One summand of a profile."""

    kind: ClassVar[str]

    @abstractmethod
    def segment(self, t: float) -> Segment:
        """The piece at `t` (finite, s): its start is at or before `t`, its end strictly after."""

    @abstractmethod
    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound over all time."""


@dataclass(frozen=True)
class ScalarTerm(Term):
    """A term whose fields are numbers, checked and converted when it is made.

    The term is 0 where its field `size` is.
    """

    size: ClassVar[str] = "amplitude"

    def __post_init__(self) -> None:
        for f in fields(self):
            if f.init:
                value = checked(getattr(self, f.name), f.metadata, f"{self.kind}.{f.name}")
                object.__setattr__(self, f.name, value)


@dataclass(frozen=True)
class Constant(ScalarTerm):
    """The constant `value`."""

    kind: ClassVar[str] = "constant"
    value: float = number_field("mean value")

    def segment(self, t: float) -> Segment:
        """One piece for all time."""
        return Segment(-inf, inf, self.value)

    def bounds(self) -> tuple[float, float]:
        """The value, twice."""
        return self.value, self.value


@dataclass(frozen=True)
class Sine(ScalarTerm):
    """``amplitude sin(omega t + phase)``; a cosine has phase π/2."""

    kind: ClassVar[str] = "sine"
    amplitude: float = number_field("amplitude of a sine")
    omega: float = number_field("angular frequency of a sine", "rad/s", neutral=1.0)
    phase: float = number_field("phase of a sine at t = 0", "rad", default=0.0)

    def segment(self, t: float) -> Segment:
        """One piece for all time."""
        return Segment(-inf, inf, smooth=((self.amplitude, self.omega, self.phase),))

    def bounds(self) -> tuple[float, float]:
        """-|amplitude| and |amplitude|; its one value if omega is 0."""
        if self.omega == 0.0:
            value = self.amplitude * sin(self.phase)
            return value, value
        return -abs(self.amplitude), abs(self.amplitude)


@dataclass(frozen=True)
class Square(ScalarTerm):
    """``amplitude sgn(sin(2π t/period + phase))``, jumping at ``(k - phase/π) period/2``.

    From jump k to jump k + 1 it is +amplitude if k is even and -amplitude if k is odd; at a jump
    it is the value after it, never sgn(0) = 0.
    """

    kind: ClassVar[str] = "square"
    amplitude: float = number_field("amplitude of a square wave")
    period: float = number_field("period of a square wave", "s", neutral=1.0, positive=True)
    phase: float = number_field("phase of a square wave at t = 0", "rad", default=0.0)

    def jump(self, k: int) -> float:
        """Time of jump `k`, s."""
        return (k - self.phase / pi) * self.period / 2.0

    def segment(self, t: float) -> Segment:
        """The half period at `t`."""
        turns, shift = 2.0 * (t / self.period), self.phase / pi
        if not abs(turns) + abs(shift) < MAX_HALF_PERIODS:
            raise ProfileError(
                f"square.period = {self.period!r}, square.phase = {self.phase!r}: the jumps near "
                f"t = {t!r} are too close, or too far from the first, for double precision"
            )
        k = floor(turns + shift)
        # The quotient is rounded, the jump times decide.
        while self.jump(k) > t:
            k -= 1
        while self.jump(k + 1) <= t:
            k += 1
        value = -self.amplitude if k % 2 else self.amplitude
        return Segment(self.jump(k), self.jump(k + 1), value)

    def bounds(self) -> tuple[float, float]:
        """-|amplitude| and |amplitude|."""
        return -abs(self.amplitude), abs(self.amplitude)


@dataclass(frozen=True)
class Chirp(ScalarTerm):
    """A sine whose frequency goes from `omega_start` at t = 0 to `omega_end` at t = duration.

    ``amplitude sin(omega_start t + (omega_end - omega_start) t²/(2 duration) + phase)`` in the
    sweep; before and after it a plain sine, with the value and the derivative continuous.
    Both ends of the sweep are events.
    """

    kind: ClassVar[str] = "chirp"
    amplitude: float = number_field("amplitude of a chirp")
    omega_start: float = number_field("angular frequency until t = 0", "rad/s", neutral=1.0)
    omega_end: float = number_field("angular frequency from t = duration on", "rad/s", neutral=1.0)
    duration: float = number_field("duration of the sweep", "s", neutral=1.0, positive=True)
    phase: float = number_field("phase of a chirp at t = 0", "rad", default=0.0)

    def segment(self, t: float) -> Segment:
        """The part before, in or after the sweep."""
        a, start, end, phase = self.amplitude, self.omega_start, self.omega_end, self.phase
        if start == end:
            return Segment(-inf, inf, smooth=((a, start, phase),))
        if t < 0.0:
            return Segment(-inf, 0.0, smooth=((a, start, phase),))
        if t < self.duration:
            sweep = (a, start, (end - start) / (2.0 * self.duration), phase)
            return Segment(0.0, self.duration, chirps=(sweep,))
        lag = (end - start) * self.duration / 2.0
        return Segment(self.duration, inf, smooth=((a, end, phase - lag),))

    def bounds(self) -> tuple[float, float]:
        """-|amplitude| and |amplitude|."""
        return -abs(self.amplitude), abs(self.amplitude)
