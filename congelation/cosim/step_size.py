"""Choice of the next macro step from the errors of the last ones."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

__all__ = ["StepSize"]

SAFETY = 0.9
LARGEST_CHANGE = 4.0
SMALLEST_CHANGE = 0.2
"""Bounds and margin as usual: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I,
section II.4."""

PROPORTIONAL, INTEGRAL = 0.4, 0.7
"""Exponents of the PI controller, to be divided by the order: K. Gustafsson, M. Lundh,
G. Soderlind, A PI stepsize control for the numerical solution of ordinary differential equations,
BIT 28 (1988); Hairer, Wanner, Solving Ordinary Differential Equations II, section IV.2."""

SMALLEST_ERROR = 1e-4
"""Floor of the scaled error: below it the step grows by the largest change anyway."""


@dataclass(frozen=True)
class StepSize:
    """The step to try, and what the controller remembers.

    Parameters
    ----------
    length : float
        Seconds.
    error_before : float
        Scaled error (1 is the tolerance) of the last accepted step.
    rejected : bool
        Whether the last trial was rejected; the step does not grow right after.
    """

    length: float
    error_before: float = 1.0
    rejected: bool = False

    def accepted(self, error: float, length: float, order: int) -> StepSize:
        """After a step of `length` with scaled error `error` <= 1, which falls with the power
        `order` of the step."""
        error = max(error, SMALLEST_ERROR)
        change = SAFETY * error ** (-INTEGRAL / order) * self.error_before ** (PROPORTIONAL / order)
        largest = 1.0 if self.rejected else LARGEST_CHANGE
        change = min(largest, max(SMALLEST_CHANGE, change))
        return replace(self, length=length * change, error_before=error, rejected=False)

    def refused(self, error: float, length: float, order: int) -> StepSize:
        """After a step of `length` that was taken back; `error` may be infinite."""
        change = SMALLEST_CHANGE
        if math.isfinite(error):
            change = min(SAFETY, max(SMALLEST_CHANGE, SAFETY * error ** (-1.0 / order)))
        return replace(self, length=length * change, rejected=True)

    def restarted(self, length: float) -> StepSize:
        """After a jump: what was before says nothing."""
        return replace(self, length=length, error_before=1.0, rejected=False)
