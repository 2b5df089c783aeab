"""Time-varying parameters θ(t): sums of constants, sines, squares, chirps, telegraphs and tables.

The paper asks of θ(t) only that it stays in a box of known radius δ; it may vary arbitrarily fast
and jump. A `Profile` is such a signal as data. Between two events (jumps, kinks of a table, ends
of a sweep) it is one smooth formula, a `Segment`; an integrator that stops at `Segment.end` and
goes on with `Profile.segment(end)` therefore never steps across a jump.

    profile(-3.0, Sine(0.6, 0.4), Square(0.4, 1.3))     -3 + 0.6 sin(0.4 t) + 0.4 sgn(sin(2π t/1.3))

Profiles are continuous from the right: at a jump, `Profile.value` is the value after it and
`Segment.value(end)` the value before it. The time of every jump is computed from its index, by
the same expression wherever it is needed, so no rounding separates a jump from its own time.

This file is copied into the FMUs as it stands: the standard library only, Python 3.9 or later.
It is one file, and longer than others, for that reason.
"""

from __future__ import annotations

import difflib
import math
import numbers
import os
import re
import reprlib
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from math import cos, floor, inf, pi, sin
from typing import Any, ClassVar, NamedTuple

__all__ = [
    "Chirp",
    "Constant",
    "FlatParameter",
    "Profile",
    "ProfileError",
    "Segment",
    "Sine",
    "Slots",
    "Square",
    "Table",
    "Telegraph",
    "Term",
    "box_radius",
    "flat_parameters",
    "profile",
    "splitmix64",
]

# Events closer than this, relative to max(1, |t|), happen together: thousands of units in the
# last place, so an integrator is never asked for a step that rounding would swallow.
COINCIDENT = 1e-12
# Half periods beyond this many cannot be told apart in double precision (53 bits, two to spare).
MAX_HALF_PERIODS = 2.0**51
# A telegraph keeps its jump times: this many are about 300 MB, far more than a simulation needs.
MAX_TELEGRAPH_JUMPS = 10_000_000
# Seeds are FMI Integers: signed, 32 bits.
MAX_SEED = 2**31 - 1


class ProfileError(ValueError):
    """A profile that cannot be; one line: the place, the value and what would be valid."""


# --- one smooth piece ---------------------------------------------------------------------------


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

    def derivative(self, t: float) -> float:
        """Derivative of this piece at `t`, 1/s times the unit of the value."""
        total = self.slope
        for a, w, p in self.smooth:
            total += a * w * cos(w * t + p)
        for a, w, k, p in self.chirps:
            total += a * (w + 2.0 * k * t) * cos((w + k * t) * t + p)
        return total


def _joined(fixed: Segment, pieces: Sequence[Segment], start: float) -> Segment:
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


# --- checks, shared by constructors, specifications and flat parameters -------------------------


def _nearest(name: str, valid: Sequence[str]) -> str:
    close = difflib.get_close_matches(name, valid, n=1, cutoff=0.4)
    return f"did you mean '{close[0]}'?" if close else "valid: " + ", ".join(valid)


def _finite(value: Any) -> float:
    """`value` as a finite float, or NaN if it is not one."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return math.nan
    try:
        number = float(value)
    except OverflowError:
        return math.nan
    return number if math.isfinite(number) else math.nan


def _checked(value: Any, meta: Mapping[str, Any], where: str) -> Any:
    """`value` as the type that `meta` declares; `where` is its name in messages."""
    if meta["type"] == "Integer":
        if isinstance(value, numbers.Integral) and not isinstance(value, bool):
            number = int(value)
            if 0 <= number <= MAX_SEED:
                return number
        wanted = f"an integer from 0 to {MAX_SEED}"
    else:
        real = _finite(value)
        if real > 0.0 or (real == real and not meta["positive"]):
            return real
        wanted = "a finite number" + (" above 0" if meta["positive"] else "")
    raise ProfileError(f"{where} = {reprlib.repr(value)}: must be {wanted}")


def _boolean(value: Any, where: str) -> bool:
    if not isinstance(value, bool):
        raise ProfileError(f"{where} = {reprlib.repr(value)}: must be true or false")
    return value


def _known(given: Mapping[str, Any], valid: Sequence[str], where: str) -> None:
    for key in given:
        if key not in valid:
            raise ProfileError(f"{where}.{key}: unknown key; {_nearest(str(key), valid)}")


def _number(
    description: str,
    unit: str = "",
    *,
    default: Any = MISSING,
    neutral: float = 0.0,
    positive: bool = False,
    integer: bool = False,
) -> Any:
    """A dataclass field that knows its unit, its domain and its neutral value as a parameter."""
    meta = {
        "type": "Integer" if integer else "Real",
        "unit": unit,
        "description": description,
        "neutral": neutral,
        "positive": positive,
    }
    return field(default=default, metadata=meta)


# --- the terms ----------------------------------------------------------------------------------


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
class _ScalarTerm(Term):
    """A term whose fields are numbers, checked and converted when it is made."""

    def __post_init__(self) -> None:
        for f in fields(self):
            if f.init:
                value = _checked(getattr(self, f.name), f.metadata, f"{self.kind}.{f.name}")
                object.__setattr__(self, f.name, value)


@dataclass(frozen=True)
class Constant(_ScalarTerm):
    """The constant `value`."""

    kind: ClassVar[str] = "constant"
    value: float = _number("mean value")

    def segment(self, t: float) -> Segment:
        """One piece for all time."""
        return Segment(-inf, inf, self.value)

    def bounds(self) -> tuple[float, float]:
        """The value, twice."""
        return self.value, self.value


@dataclass(frozen=True)
class Sine(_ScalarTerm):
    """``amplitude sin(omega t + phase)``; a cosine has phase π/2."""

    kind: ClassVar[str] = "sine"
    amplitude: float = _number("amplitude of a sine")
    omega: float = _number("angular frequency of a sine", "rad/s", neutral=1.0)
    phase: float = _number("phase of a sine at t = 0", "rad", default=0.0)

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
class Square(_ScalarTerm):
    """``amplitude sgn(sin(2π t/period + phase))``, jumping at ``(k - phase/π) period/2``.

    From jump k to jump k + 1 it is +amplitude if k is even and -amplitude if k is odd; at a jump
    it is the value after it, never sgn(0) = 0.
    """

    kind: ClassVar[str] = "square"
    amplitude: float = _number("amplitude of a square wave")
    period: float = _number("period of a square wave", "s", neutral=1.0, positive=True)
    phase: float = _number("phase of a square wave at t = 0", "rad", default=0.0)

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
class Chirp(_ScalarTerm):
    """A sine whose frequency goes from `omega_start` at t = 0 to `omega_end` at t = duration.

    ``amplitude sin(omega_start t + (omega_end - omega_start) t²/(2 duration) + phase)`` in the
    sweep; before and after it a plain sine, with the value and the derivative continuous.
    Both ends of the sweep are events.
    """

    kind: ClassVar[str] = "chirp"
    amplitude: float = _number("amplitude of a chirp")
    omega_start: float = _number("angular frequency until t = 0", "rad/s", neutral=1.0)
    omega_end: float = _number("angular frequency from t = duration on", "rad/s", neutral=1.0)
    duration: float = _number("duration of the sweep", "s", neutral=1.0, positive=True)
    phase: float = _number("phase of a chirp at t = 0", "rad", default=0.0)

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


def splitmix64(seed: int, k: int) -> int:
    """Output `k` (from 1) of the SplitMix64 generator started with `seed`, a 64-bit integer.

    Steele, Lea and Flood, Fast splittable pseudorandom number generators, OOPSLA 2014: the
    state advances by a constant, so that output k is a function of seed and k alone.
    """
    mask = 0xFFFFFFFFFFFFFFFF
    z = (seed + k * 0x9E3779B97F4A7C15) & mask
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
    return z ^ (z >> 31)


def _log(u: float) -> float:
    """The natural logarithm of u > 0, from + - * / alone.

    The C libraries' logarithms differ in the last bit from machine to machine; IEEE arithmetic
    does not. With u = m 2^e, m in [1/√2, √2) and s = (m - 1)/(m + 1):
    log u = e log 2 + 2 (s + s³/3 + s⁵/5 + ..), where s² < 0.03 leaves 1e-18 after s²³/23.
    """
    m, e = math.frexp(u)
    if m < 0.7071067811865476:
        m, e = 2.0 * m, e - 1
    s = (m - 1.0) / (m + 1.0)
    series = 0.0
    for odd in range(23, 0, -2):
        series = series * (s * s) + 1.0 / odd
    return e * 0.6931471805599453 + 2.0 * s * series


@dataclass(frozen=True)
class Telegraph(_ScalarTerm):
    """Random telegraph signal: ±amplitude, exponential holding times of mean 1/rate from t = 0.

    With r_k = `splitmix64` (seed, k): it starts at +amplitude if the top bit of r_1 is 0, else at
    -amplitude (and has that value for t < 0), and jumps at T_1 < T_2 < .., where
    T_0 = 0, T_k = T_{k-1} - log(u_k)/rate and u_k = (floor(r_{k+1}/2^11) + 1) 2^-53, in (0, 1].
    """

    kind: ClassVar[str] = "telegraph"
    amplitude: float = _number("amplitude of a telegraph signal")
    rate: float = _number("mean number of jumps per second", "1/s", neutral=1.0, positive=True)
    seed: int = _number("seed of a telegraph signal", neutral=1, integer=True)
    # Jump times known so far; a memory of a pure function, so no part of the value.
    _jumps: list[float] = field(default_factory=list, init=False, repr=False, compare=False)

    def _known_until(self, t: float) -> list[float]:
        """The jump times, the last of them strictly after `t`."""
        jumps = self._jumps
        last = jumps[-1] if jumps else 0.0
        if last <= t and self.rate * t > MAX_TELEGRAPH_JUMPS:
            raise ProfileError(f"telegraph.rate = {self.rate!r}: too many jumps until t = {t!r}")
        while last <= t or not jumps:
            u = ((splitmix64(self.seed, len(jumps) + 2) >> 11) + 1) * 2.0**-53
            last -= _log(u) / self.rate
            jumps.append(last)
        return jumps

    def segment(self, t: float) -> Segment:
        """The piece between the jumps around `t`."""
        jumps = self._known_until(t)
        n = bisect_right(jumps, t)
        start = jumps[n - 1] if n else -inf
        flipped = (splitmix64(self.seed, 1) >> 63) ^ (n & 1)
        return Segment(start, jumps[n], -self.amplitude if flipped else self.amplitude)

    def bounds(self) -> tuple[float, float]:
        """-|amplitude| and |amplitude|."""
        return -abs(self.amplitude), abs(self.amplitude)


def _table_fault(times: Sequence[float], values: Sequence[float]) -> tuple[int, str] | None:
    """The first row (from 0) that cannot stand, and why."""
    for i, time in enumerate(times):
        if i and not times[i - 1] < time:
            return i, f"time {time!r} does not come after {times[i - 1]!r}"
        if i and math.isinf((values[i] - values[i - 1]) / (time - times[i - 1])):
            return i, f"the step from {values[i - 1]!r} to {values[i]!r} is beyond double precision"
    return None


@dataclass(frozen=True)
class Table(Term):
    """Values at given times, held from each time to the next, or joined by straight lines.

    Before the first time it has the first value, after the last time the last one. Each time is
    an event.

    Parameters
    ----------
    times, values : sequence of float
        Equally long, at least one; the times strictly increasing, s.
    linear : bool
        False: piecewise constant. True: piecewise linear.
    file : str
        The file they came from, if any; needed to write the table as flat parameters.
    """

    kind: ClassVar[str] = "table"
    times: tuple[float, ...]
    values: tuple[float, ...]
    linear: bool = False
    file: str = ""

    def __post_init__(self) -> None:
        for name in ("times", "values"):
            given = getattr(self, name)
            if isinstance(given, str) or not isinstance(given, Sequence) or not given:
                raise ProfileError(
                    f"table.{name} = {reprlib.repr(given)}: must be a list of at least one number"
                )
            meta = {"type": "Real", "positive": False}
            row = tuple(_checked(v, meta, f"table.{name}[{i}]") for i, v in enumerate(given, 1))
            object.__setattr__(self, name, row)
        _boolean(self.linear, "table.linear")
        if len(self.times) != len(self.values):
            raise ProfileError(
                f"table: {len(self.times)} times but {len(self.values)} values; one value per time"
            )
        fault = _table_fault(self.times, self.values)
        if fault:
            raise ProfileError(f"table.times[{fault[0] + 1}]: {fault[1]}")

    @classmethod
    def from_csv(cls, path: str | os.PathLike[str], linear: bool = False) -> Table:
        """Read a table from two columns ``time,value``.

        The first line may be a header; what follows a # is a comment.

        Raises
        ------
        ProfileError
            Naming the file and the line.
        """
        name = os.fspath(path)
        try:
            with open(name, encoding="utf-8-sig") as stream:
                lines = stream.read().splitlines()
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "not a text file in UTF-8"
            raise ProfileError(f"table file {name!r}: {reason}") from None
        times, values, numbers_of_lines = [], [], []
        header_possible = True
        for number, line in enumerate(lines, 1):
            text = line.split("#", 1)[0].strip()
            if not text:
                continue
            row = [_parsed(cell) for cell in text.split(",")]
            if len(row) == 2 and all(math.isfinite(v) for v in row):
                times.append(row[0])
                values.append(row[1])
                numbers_of_lines.append(number)
            elif not (header_possible and len(row) == 2 and all(math.isnan(v) for v in row)):
                raise ProfileError(
                    f"table file {name!r}, line {number}: {reprlib.repr(text)} is not time,value "
                    "(two finite numbers)"
                )
            header_possible = False
        if not times:
            raise ProfileError(f"table file {name!r}: no rows; expected two columns time,value")
        fault = _table_fault(times, values)
        if fault:
            raise ProfileError(
                f"table file {name!r}, line {numbers_of_lines[fault[0]]}: {fault[1]}"
            )
        return cls(tuple(times), tuple(values), linear, name)

    def segment(self, t: float) -> Segment:
        """The piece between the times around `t`."""
        times, values = self.times, self.values
        n = bisect_right(times, t)
        end = times[n] if n < len(times) else inf
        if n == 0:
            return Segment(-inf, end, values[0])
        if self.linear and n < len(times):
            slope = (values[n] - values[n - 1]) / (end - times[n - 1])
            return Segment(times[n - 1], end, values[n - 1], slope=slope)
        return Segment(times[n - 1], end, values[n - 1])

    def bounds(self) -> tuple[float, float]:
        """The least and the greatest value."""
        return min(self.values), max(self.values)


def _parsed(cell: str) -> float:
    """The number in a cell of a CSV file, NaN if it is none."""
    try:
        return float(cell)
    except ValueError:
        return math.nan


_SCALAR_TERMS: tuple[type[_ScalarTerm], ...] = (Constant, Sine, Square, Chirp, Telegraph)
_BY_KIND = {cls.kind: cls for cls in _SCALAR_TERMS}
_KINDS = (*_BY_KIND, Table.kind)


def _parameters(cls: type[_ScalarTerm]) -> dict[str, Any]:
    """The fields that a user gives, by name."""
    return {f.name: f for f in fields(cls) if f.init}


# --- flat parameters: a profile as the variables of an FMU --------------------------------------


@dataclass(frozen=True)
class Slots:
    """How many terms of each kind the flat parameters have room for."""

    sines: int = 2
    squares: int = 2
    chirps: int = 1
    telegraphs: int = 1
    table: bool = True

    def count(self, kind: str) -> int:
        """Number of slots for terms of `kind`: sine, square, chirp or telegraph."""
        counts = {
            "sine": self.sines,
            "square": self.squares,
            "chirp": self.chirps,
            "telegraph": self.telegraphs,
        }
        return counts[kind]


class FlatParameter(NamedTuple):
    """One parameter of a profile, as an FMU shows it.

    `type` is one of ``"Real"``, ``"Integer"``, ``"Boolean"``, ``"String"``; with every parameter at
    its `default` the profile is 0.
    """

    name: str
    type: str
    default: float | int | bool | str
    unit: str
    description: str


_SLOTTED = ("sine", "square", "chirp", "telegraph")
_MEAN = "mean"
_TABLE_FILE = "table.file"
_TABLE_LINEAR = "table.linear"
_SLOT_NAME = re.compile(r"(\w+)\[([1-9]\d*)\]\.(\w+)")
DEFAULT_SLOTS = Slots()


def _default(f: Any) -> Any:
    return f.metadata["neutral"] if f.default is MISSING else f.default


def flat_parameters(slots: Slots = DEFAULT_SLOTS) -> list[FlatParameter]:
    """The flat parameters of a profile with these slots, in the order of their names in FMUs."""
    listed = [FlatParameter(_MEAN, "Real", 0.0, "", "mean value")]
    for kind in _SLOTTED:
        for k in range(1, slots.count(kind) + 1):
            for name, f in _parameters(_BY_KIND[kind]).items():
                meta = f.metadata
                listed.append(
                    FlatParameter(
                        f"{kind}[{k}].{name}",
                        meta["type"],
                        _default(f),
                        meta["unit"],
                        meta["description"],
                    )
                )
    if slots.table:
        about_file = "CSV file of two columns time,value added to the profile; empty: none"
        about_linear = "true: straight lines between the rows; false: each value held"
        listed.append(FlatParameter(_TABLE_FILE, "String", "", "", about_file))
        listed.append(FlatParameter(_TABLE_LINEAR, "Boolean", False, "", about_linear))
    return listed


# --- the sum ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Profile:
    """The sum of `terms`; see the head of this module.

    Parameters
    ----------
    terms : sequence of Term
        Empty: the profile is 0.

    Raises
    ------
    ProfileError
        If something is not a `Term`, or the bounds overflow.
    """

    terms: tuple[Term, ...] = ()
    # The terms that hold for all time, joined once, and those that have events.
    _fixed: Segment = field(init=False, repr=False, compare=False)
    _eventful: tuple[Term, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for term in self.terms:
            if not isinstance(term, Term):
                raise ProfileError(f"{reprlib.repr(term)}: must be one of " + ", ".join(_KINDS))
        object.__setattr__(self, "terms", tuple(self.terms))
        try:
            self.bounds()
        except OverflowError:
            raise ProfileError(f"{reprlib.repr(self.terms)}: the sum must be finite") from None
        first = [(term, term.segment(0.0)) for term in self.terms]
        fixed = [piece for _, piece in first if piece.start == -inf and piece.end == inf]
        eventful = tuple(term for term, piece in first if piece.start > -inf or piece.end < inf)
        object.__setattr__(self, "_fixed", _joined(Segment(-inf, inf), fixed, -inf))
        object.__setattr__(self, "_eventful", eventful)

    def segment(self, t: float) -> Segment:
        """The piece at `t`: ``start <= t < end``.

        Events within `COINCIDENT` (relative) after another one are taken to happen with it. Every
        segment is longer than that, so that stepping from end to end always advances.
        """
        if not -inf < t < inf:
            raise ProfileError(f"t = {t!r}: must be a finite number")
        if not self._eventful:
            return self._fixed
        pieces = [term.segment(t) for term in self._eventful]
        start = max([piece.start for piece in pieces])
        if start > -inf:
            settled = start + COINCIDENT * max(1.0, abs(start))
            if min([piece.end for piece in pieces]) <= settled:
                pieces = [term.segment(settled) for term in self._eventful]
        return _joined(self._fixed, pieces, start)

    def value(self, t: float) -> float:
        """Value at `t` (s); at a jump, the value after it."""
        return self.segment(t).value(t)

    def derivative(self, t: float) -> float:
        """Derivative at `t` (s); at an event, the one after it."""
        return self.segment(t).derivative(t)

    def next_event(self, t: float) -> float:
        """The first event strictly after `t`, s; inf if there is none."""
        return self.segment(t).end

    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound over all time: the sums of the terms' bounds.

        Reached exactly by terms of unrelated periods, such as those of system (60) in our
        profile; for others the range may be smaller.
        """
        pairs = [term.bounds() for term in self.terms]
        return math.fsum([low for low, _ in pairs]), math.fsum([high for _, high in pairs])

    @property
    def radius(self) -> float:
        """Half the distance between the bounds: this component's share of δ, cf. `box_radius`."""
        low, high = self.bounds()
        return high / 2.0 - low / 2.0

    @classmethod
    def from_spec(cls, spec: Any, where: str = "profile", base: str = "") -> Profile:
        """The profile that a list of one-key tables describes, as read from TOML.

        Parameters
        ----------
        spec : list of dict
            Such as ``[{"constant": -3.0}, {"sine": {"amplitude": 0.6, "omega": 0.4}}]``; a number
            alone is a constant. Keys: the fields of the terms; a table has `times` and `values`,
            or `file`, and may have `linear`.
        where : str
            Place of `spec` in its file, for messages.
        base : str
            Folder to which the files of tables are relative.

        Raises
        ------
        ProfileError
            Naming the path (terms counted from 1), the value, and the nearest valid key.
        """
        if _finite(spec) == _finite(spec):
            return cls((Constant(spec),))
        if not isinstance(spec, (list, tuple)):
            raise ProfileError(
                f"{where} = {reprlib.repr(spec)}: must be a finite number or a list of terms, "
                "such as [{constant = -3.0}, {sine = {amplitude = 0.6, omega = 0.4}}]"
            )
        return cls(tuple(_term(item, f"{where}[{k}]", base) for k, item in enumerate(spec, 1)))

    def to_spec(self) -> list[dict[str, Any]]:
        """The list that `from_spec` turns into an equal profile."""
        return [{term.kind: _body(term)} for term in self.terms]

    @classmethod
    def from_flat(cls, values: Mapping[str, Any], base: str = "") -> Profile:
        """The profile that flat parameters describe; those left out have their defaults.

        Parameters
        ----------
        values : mapping of str to float, int, bool or str
            By the names of `flat_parameters`. Terms of amplitude 0 are checked, then dropped.
        base : str
            Folder to which a relative ``table.file`` is relative.

        Raises
        ------
        ProfileError
            Naming the parameter, the value, and the nearest valid name.
        """
        slots: dict[tuple[int, int], dict[str, Any]] = {}
        for name, value in values.items():
            if name in (_MEAN, _TABLE_FILE, _TABLE_LINEAR):
                continue
            match = _SLOT_NAME.fullmatch(name)
            kind, k, key = match.groups() if match else ("", "1", "")
            if kind not in _SLOTTED or key not in _parameters(_BY_KIND[kind]):
                valid = [p.name.replace("[1]", f"[{k}]") for p in flat_parameters()]
                raise ProfileError(f"{name}: unknown parameter; {_nearest(name, valid)}")
            slots.setdefault((_SLOTTED.index(kind), int(k)), {})[key] = value
        mean = _checked(values.get(_MEAN, 0.0), {"type": "Real", "positive": False}, _MEAN)
        terms: list[Term] = [Constant(mean)] if mean else []
        for (order, k), given in sorted(slots.items()):
            kind = _SLOTTED[order]
            full = {name: _default(f) for name, f in _parameters(_BY_KIND[kind]).items()}
            full.update(given)
            term = _scalar_term(kind, full, f"{kind}[{k}]")
            if full["amplitude"]:
                terms.append(term)
        linear = _boolean(values.get(_TABLE_LINEAR, False), _TABLE_LINEAR)
        if values.get(_TABLE_FILE, ""):
            terms.append(_table_of_file(values[_TABLE_FILE], linear, _TABLE_FILE, base))
        return cls(tuple(terms))

    def to_flat(self, slots: Slots = DEFAULT_SLOTS) -> dict[str, Any]:
        """All flat parameters for `slots`; constants are added up into ``mean``.

        Raises
        ------
        ProfileError
            If there are more terms of a kind than slots, or a table that has no file.
        """
        flat: dict[str, Any] = {p.name: p.default for p in flat_parameters(slots)}
        flat[_MEAN] = math.fsum([t.value for t in self.terms if isinstance(t, Constant)])
        for kind in _SLOTTED:
            terms = [term for term in self.terms if term.kind == kind]
            if len(terms) > slots.count(kind):
                raise ProfileError(f"{len(terms)} terms {kind}: at most {slots.count(kind)} fit")
            for k, term in enumerate(terms, 1):
                flat.update({f"{kind}[{k}].{key}": v for key, v in _body(term).items()})
        tables = [term for term in self.terms if isinstance(term, Table)]
        if len(tables) > int(slots.table):
            raise ProfileError(f"{len(tables)} terms table: at most {int(slots.table)} fit")
        for table in tables:
            if not table.file:
                raise ProfileError("table.times: give the rows in a CSV file, as table.file")
            flat.update({_TABLE_FILE: table.file, _TABLE_LINEAR: table.linear})
        return flat


def profile(*terms: Term | float) -> Profile:
    """The sum of `terms`, numbers among them standing for constants."""
    return Profile(tuple(t if isinstance(t, Term) else Constant(t) for t in terms))


def box_radius(profiles: Sequence[Profile]) -> float:
    """δ = |θ_max - θ_min|/2 of the box that holds the vector of these profiles (Sec. II)."""
    return math.sqrt(sum([p.radius**2 for p in profiles], 0.0))


def _body(term: Term) -> Any:
    """What stands behind the term's kind in a specification."""
    if isinstance(term, Constant):
        return term.value
    if isinstance(term, Table):
        if term.file:
            return {"file": term.file, "linear": term.linear}
        return {"times": list(term.times), "values": list(term.values), "linear": term.linear}
    if isinstance(term, _ScalarTerm):
        return {name: getattr(term, name) for name in _parameters(type(term))}
    raise ProfileError(f"{reprlib.repr(term)}: must be one of " + ", ".join(_KINDS))


def _scalar_term(kind: str, given: Mapping[str, Any], where: str) -> Term:
    """The term of `kind` with these fields, which are called ``where.field`` in messages."""
    cls = _BY_KIND[kind]
    known = _parameters(cls)
    _known(given, list(known), where)
    for name, f in known.items():
        if name in given:
            _checked(given[name], f.metadata, f"{where}.{name}")
        elif f.default is MISSING:
            raise ProfileError(f"{where}.{name}: missing; {f.metadata['description']}")
    return cls(**given)


def _table_of_file(file: Any, linear: bool, where: str, base: str) -> Table:
    if not isinstance(file, str):
        raise ProfileError(f"{where} = {reprlib.repr(file)}: must be the name of a CSV file")
    try:
        return Table.from_csv(os.path.join(base, file), linear)
    except ProfileError as error:
        raise ProfileError(f"{where}: {error}") from None


def _term(item: Any, where: str, base: str) -> Term:
    """The term that one element of a specification describes."""
    if not isinstance(item, Mapping) or len(item) != 1:
        raise ProfileError(
            f"{where} = {reprlib.repr(item)}: must be one term, such as {{constant = -3.0}}; "
            "terms: " + ", ".join(_KINDS)
        )
    ((kind, body),) = item.items()
    _known(item, _KINDS, where)
    where = f"{where}.{kind}"
    if kind == Constant.kind:
        _checked(body, {"type": "Real", "positive": False}, where)
        return Constant(body)
    if not isinstance(body, Mapping):
        keys = ("file", "linear") if kind == Table.kind else tuple(_parameters(_BY_KIND[kind]))
        raise ProfileError(f"{where} = {reprlib.repr(body)}: must be a table of " + ", ".join(keys))
    if kind != Table.kind:
        return _scalar_term(kind, body, where)
    _known(body, ("times", "values", "file", "linear"), where)
    linear = _boolean(body.get("linear", False), f"{where}.linear")
    if ("file" in body) == ("times" in body or "values" in body):
        raise ProfileError(f"{where}: give either file, or times and values")
    if "file" in body:
        return _table_of_file(body["file"], linear, f"{where}.file", base)
    try:
        return Table(body.get("times", ()), body.get("values", ()), linear)
    except ProfileError as error:
        raise ProfileError(f"{where.rsplit('.', 1)[0]}.{error}") from None
