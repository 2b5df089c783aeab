"""Sampled random numbers, the same to the bit on every machine."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor
from typing import ClassVar

from .checks import ProfileError, number_field
from .segment import Segment
from .telegraph import splitmix64
from .terms import ScalarTerm

__all__ = ["Noise"]

# A uniform number on [0, 1) has the variance 1/12, so the sum of twelve has the variance 1.
UNIFORMS = 12
# Of samples beyond this many, start and end cannot be told apart in double precision.
MAX_SAMPLES = 2.0**51


@dataclass(frozen=True)
class Noise(ScalarTerm):
    """Independent random values of mean 0 and standard deviation `deviation`, each held a sample.

    With u_j = floor(`splitmix64` (seed, j)/2^11) 2^-53, in [0, 1), the value for
    k T <= t < (k + 1) T, T = sample_time, is deviation (u_{12 k + 1} + .. + u_{12 k + 12} - 6):
    normally distributed but for its tails, which end at six deviations, from + and * alone.
    """

    kind: ClassVar[str] = "noise"
    size: ClassVar[str] = "deviation"
    deviation: float = number_field("standard deviation of sampled noise")
    sample_time: float = number_field(
        "time between samples of noise", "s", neutral=0.01, positive=True
    )
    seed: int = number_field("seed of sampled noise", neutral=1, integer=True)

    def segment(self, t: float) -> Segment:
        """The sample at `t`."""
        samples = t / self.sample_time
        if not abs(samples) < MAX_SAMPLES:
            raise ProfileError(
                f"noise.sample_time = {self.sample_time!r}: the samples near t = {t!r} are too "
                "short for double precision"
            )
        k = floor(samples)
        # The quotient is rounded, the times of the samples decide.
        while k * self.sample_time > t:
            k -= 1
        while (k + 1) * self.sample_time <= t:
            k += 1
        total = 0.0
        for j in range(UNIFORMS * k + 1, UNIFORMS * (k + 1) + 1):
            total += (splitmix64(self.seed, j) >> 11) * 2.0**-53
        value = self.deviation * (total - UNIFORMS / 2)
        return Segment(k * self.sample_time, (k + 1) * self.sample_time, value)

    def bounds(self) -> tuple[float, float]:
        """Minus and plus six deviations."""
        most = abs(self.deviation) * UNIFORMS / 2
        return -most, most
