"""Inputs as polynomials through values and derivatives at both ends of the step."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.base import AdaptiveStepper, Coupling
from congelation.cosim.coupling.ends import Ends
from congelation.cosim.coupling.feedback import Feedback
from congelation.cosim.coupling.interpolant import HIGH, LOW, Interpolant
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange
from congelation.cosim.result import RunEnded, Status
from congelation.cosim.states import Checkpoint
from congelation.cosim.system import MAX_DERIVATIVE
from congelation.errors import InvalidInput
from congelation.fmi.slave import StepDiscarded

__all__ = ["Hermite"]

Floats = npt.NDArray[np.float64]

ACCELERATIONS = ("broyden", "none")

SHARE_OF_TOLERANCE = 0.3
"""Of a step's error tolerance, the part left to unfinished sweeps."""

FIRST_CHANGE = 3e-2
"""Share of its size by which an input may change over the first step that is tried."""


@dataclass(frozen=True)
class Hermite(Coupling):
    """Every input is the cubic through value and derivative of its source at both ends of a step.

    The ends are first extrapolated, then found by sweeps: all slaves step in the declared order,
    the outputs at the end give new polynomials, and the step is repeated from saved states until
    the outputs change by less than a tolerance. Order 4. For a linear loop that is the
    two-derivative Obreshkov formula (Hairer, Norsett, Wanner, Solving Ordinary Differential
    Equations I, section III.5), whose stability function is the (2, 2) Pade approximation of the
    exponential: as long as the sweeps converge, accuracy alone limits the step.

    Order 6 takes the point before the step as well: the cubic then has the first two moments of
    the quintic through all three points, which is what the states at the end of the step come
    from. It is stable only for steps not much longer than the loop's shortest time constant.

    An input that takes a value and one derivative gets the chord, one that takes a value alone the
    cubic's mean. A source without derivatives gets them from its past values.

    Parameters
    ----------
    order : int or None
        4, 6, or None: 4 where steps are fixed; where they are chosen by a tolerance, whichever
        allows the longer step. The first step after a jump always has order 4. Order 6 is for
        inputs that take three derivatives, from sources that provide one.
    sweeps : int or None
        Exactly so many plain sweeps per step; with None, as many as it takes.
    tolerance : float
        Change at which sweeps end, relative to nominal value plus size. Where steps are chosen by a
        tolerance, it is 0.3 times that one instead.
    max_sweeps : int
        After these a step counts as not converged.
    acceleration : str
        "broyden": quasi-Newton steps on the inputs that are fed back, which converge where loop
        gain times step is beyond 1; "none": plain sweeps.
    """

    order: int | None = None
    sweeps: int | None = None
    tolerance: float = 1e-9
    max_sweeps: int = 12
    acceleration: str = "broyden"
    name: ClassVar[str] = "hermite"
    needs_derivatives: ClassVar[bool] = True
    lands_on_events: ClassVar[bool] = True
    takes_tolerance: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.acceleration not in ACCELERATIONS:
            valid = ", ".join(ACCELERATIONS)
            raise InvalidInput(f"acceleration '{self.acceleration}'; valid: {valid}")
        if self.order not in (None, LOW, HIGH):
            raise InvalidInput(f"order {self.order}; valid: {LOW}, {HIGH}")
        for name, value in (("sweeps", self.sweeps), ("max_sweeps", self.max_sweeps)):
            if value is not None and value < 1:
                raise InvalidInput(f"{name} {value}: at least 1 is needed")
        if not 0.0 < self.tolerance < 1.0:
            raise InvalidInput(
                f"tolerance {self.tolerance:g} of the sweeps must lie between 0 and 1"
            )

    @property
    def rolls_back(self) -> bool:
        """Every sweep but the first repeats the step."""
        return self.sweeps != 1

    def stepper(
        self, ensemble: Ensemble, exchange: Exchange, tolerance: float | None
    ) -> AdaptiveStepper:
        """This coupling at work."""
        accuracy = self.tolerance if tolerance is None else SHARE_OF_TOLERANCE * tolerance
        checkpoint = (
            Checkpoint(ensemble.slaves) if self.rolls_back or tolerance is not None else None
        )
        ends = Ends(ensemble)
        interpolant = self._interpolant(ensemble, ends, tolerance)
        return _HermiteStepper(self, ensemble, exchange, ends, interpolant, accuracy, checkpoint)

    def _interpolant(self, ensemble: Ensemble, ends: Ends, tolerance: float | None) -> Interpolant:
        unfit = ends.inexact | (ensemble.inputs.order < MAX_DERIVATIVE)
        if self.order == HIGH and unfit.any():
            link = ensemble.inputs.links[int(unfit.argmax())]
            raise InvalidInput(
                f"coupling '{self.name}': order {HIGH} needs a derivative of the source and an "
                f"input that takes three; the connection {link.name} is without"
            )
        if self.order is not None:
            return Interpolant(ends, self.order, None)
        able = tolerance is not None and not unfit.any()
        return Interpolant(ends, HIGH if able else LOW, tolerance)


class _HermiteStepper(AdaptiveStepper):
    def __init__(
        self,
        coupling: Hermite,
        ensemble: Ensemble,
        exchange: Exchange,
        ends: Ends,
        interpolant: Interpolant,
        accuracy: float,
        checkpoint: Checkpoint | None,
    ) -> None:
        self._coupling = coupling
        self._ensemble = ensemble
        self._exchange = exchange
        self._accuracy = accuracy
        self._checkpoint = checkpoint
        self._is_saved = False
        self._ends = ends
        self._interpolant = interpolant
        self._feedback = Feedback(ensemble, self._ends, coupling.acceleration == "broyden")
        links = ensemble.inputs.links
        self._forward = [
            np.array([link.source == m < link.target for link in links], bool)
            for m in range(len(ensemble.slaves))
        ]
        self._feeds = [bool(mask.any()) for mask in self._forward]
        order = ensemble.inputs.order
        self._low = [np.flatnonzero(order == k) for k in range(3)]
        self._is_low = any(part.size for part in self._low)
        self._held = [bool((order[part] == 0).any()) for part in ensemble.inputs.columns]
        self._calls_per_sweep = ensemble.calls_per_sweep + 2 * sum(self._held)
        self._error = 0.0
        self.sweeps = 0
        self.estimated_error = 0.0
        self.order = LOW

    def start(self, time: float) -> None:
        self._ends.start(time)
        self._interpolant.start(time)
        self._is_saved = False

    def advance(self, time: float, end: float) -> None:
        if not math.isfinite(self.attempt(time, end)):
            raise RunEnded(
                Status.NOT_CONVERGED,
                f"the step from t = {time:.9g} to {end:.9g}: sweeps left the connection "
                f"{self.worst()} changing (at most {self._coupling.max_sweeps} are made)",
            )
        self.accept()

    def attempt(self, time: float, end: float) -> float:
        if self._checkpoint is not None and not self._is_saved:
            self._checkpoint.save()
            self._is_saved = True
        length = end - time
        self._ends.open(time, end)
        self._interpolant.open()
        self._feedback.open(length)
        converged = self._sweeps(time, length)
        self._error = self._interpolant.error() if converged else math.inf
        self.order = self._interpolant.order
        return self._error

    def _sweeps(self, time: float, length: float) -> bool:
        """Sweep until the ends that are fed back settle; whether they did."""
        wanted, most = self._coupling.sweeps, self._coupling.max_sweeps
        for count in range(1, (wanted or most) + 1):
            if count > 1 and self._checkpoint is not None:
                self._checkpoint.restore()
            try:
                self._sweep(time, length)
            except StepDiscarded:
                # Not by the step itself, which the first sweep could make, but by where later
                # sweeps have led.
                if count == 1:
                    raise
                return False
            change = self._feedback.change()
            if not math.isfinite(change):
                if count == 1:
                    self._ensemble.outputs.check(time + length)
                return False
            if wanted is not None:
                self._feedback.take_over()
            elif change <= self._accuracy:
                return True
            else:
                self._feedback.improve()
        return wanted is not None

    def _sweep(self, time: float, length: float) -> None:
        """All slaves once over the step, with the inputs' ends as they are known by now."""
        ensemble, ends = self._ensemble, self._ends
        for m, slave in enumerate(ensemble.slaves):
            self._interpolant.coefficients(ensemble.inputs.C)
            if self._is_low:
                self._lower(length)
            ensemble.inputs.write[m]()
            slave.step(time, length, self._checkpoint is None)
            ensemble.outputs.read[m]()
            if self._held[m]:
                self._reach_end(m)
            ends.read()
            if self._feeds[m]:
                np.copyto(ends.w[2:], ends.new, where=self._forward[m])
        self.sweeps += 1

    def _lower(self, length: float) -> None:
        """Polynomials for inputs that take fewer than three derivatives."""
        C, w = self._ensemble.inputs.C, self._ends.w
        held, linear, quadratic = self._low
        mean = (w[0] + w[2]) / 2.0 + (w[1] - w[3]) * (length / 12.0)
        C[0, held] = mean[held]
        C[1, linear] = (w[2, linear] - w[0, linear]) / length
        rise = w[2, quadratic] - w[0, quadratic] - length * w[1, quadratic]
        C[2, quadratic] = 2.0 * rise / length**2

    def _reach_end(self, m: int) -> None:
        """Outputs of a slave with held inputs, for the inputs' values at the end of the step."""
        ensemble = self._ensemble
        ensemble.inputs.C[0] = self._ends.w[2]
        ensemble.inputs.C[1:] = 0.0
        ensemble.inputs.write[m]()
        ensemble.outputs.read[m]()

    def accept(self) -> None:
        self._ends.close()
        self._interpolant.close()
        self._is_saved = False
        self.estimated_error = max(self.estimated_error, self._error)
        if self._ensemble.system.discrete_links:
            self._ensemble.copy_discrete()

    def reject(self) -> None:
        self._feedback.undo()
        if self._checkpoint is not None:
            self._checkpoint.restore()

    def worst(self) -> str:
        if math.isfinite(self._error):
            return self._ensemble.inputs.links[self._interpolant.worst].name
        return self._feedback.worst()

    def first_step(self) -> float:
        return self._ends.time_scale() * FIRST_CHANGE

    def finish(self) -> None:
        saved = self._checkpoint.calls if self._checkpoint is not None else 0
        self.calls = self.sweeps * self._calls_per_sweep + self._exchange.calls + saved
