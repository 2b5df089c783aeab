"""Random telegraph signals, the same to the bit on every machine."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from math import inf
from typing import ClassVar

from .checks import ProfileError, number_field
from .segment import Segment
from .terms import ScalarTerm

__all__ = ["MAX_TELEGRAPH_JUMPS", "Telegraph", "splitmix64"]

# A telegraph keeps its jump times: this many are about 300 MB, far more than a simulation needs.
MAX_TELEGRAPH_JUMPS = 10_000_000


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
class Telegraph(ScalarTerm):
    """Random telegraph signal: ±amplitude, exponential holding times of mean 1/rate from t = 0.

    With r_k = `splitmix64` (seed, k): it starts at +amplitude if the top bit of r_1 is 0, else at
    -amplitude (and has that value for t < 0), and jumps at T_1 < T_2 < .., where
    T_0 = 0, T_k = T_{k-1} - log(u_k)/rate and u_k = (floor(r_{k+1}/2^11) + 1) 2^-53, in (0, 1].
    """

    kind: ClassVar[str] = "telegraph"
    amplitude: float = number_field("amplitude of a telegraph signal")
    rate: float = number_field("mean number of jumps per second", "1/s", neutral=1.0, positive=True)
    seed: int = number_field("seed of a telegraph signal", neutral=1, integer=True)
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
