"""Inputs as polynomials through values and derivatives at both ends of the step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from congelation.cosim.broyden import broyden_step, learnt
from congelation.cosim.coupling.base import AdaptiveStepper, Coupling, Trial
from congelation.cosim.coupling.feedback import Feedback, HermitePlan, HermiteState
from congelation.cosim.coupling.interpolant import (
    HIGH,
    LOW,
    Piece,
    estimated_error,
    opened,
    order_of_longer_step,
)
from congelation.cosim.coupling.points import LinkReader, Points
from congelation.cosim.coupling.polynomial import product
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange, settle_discrete
from congelation.cosim.result import RunEnded, Status
from congelation.cosim.system import MAX_DERIVATIVE
from congelation.errors import InvalidInput
from congelation.fmi.slave import StepDiscarded

__all__ = ["Hermite", "HermiteStepper"]

Floats = npt.NDArray[np.float64]

ACCELERATIONS = ("broyden", "none")
JUMPS = ("refuse", "pass")
CONTROLS = ("halves", "prediction")

SHARE_OF_TOLERANCE = 0.3
"""Part of a step's error tolerance that is left to unfinished iterations."""

SHARE_OF_HALVED = 1e-4
"""The same part where the error of a step is the difference of two solutions, in which unfinished
iterations of either must not show, or is only predicted."""

HELD = 2
"""Order where an input cannot follow the cubic, or a source has no derivative."""

FIRST_CHANGE = 3e-2
"""Share of its size by which an input may change over the first step that is tried."""


@dataclass(frozen=True)
class Hermite(Coupling):
    """Every input is the cubic through value and derivative of its source at both ends of a step.

    The ends are first extrapolated, then found by iterations: all slaves step in the declared
    order, the outputs at the end give new polynomials, and the step is repeated from saved states
    until the outputs change by less than a tolerance. Order 4. For a linear loop that is the
    two-derivative Obreshkov formula (Hairer, Norsett, Wanner, Solving Ordinary Differential
    Equations I, section III.5), whose stability function is the (2, 2) Pade approximation of the
    exponential: as long as the iterations converge, accuracy alone limits the step.

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
    iterations : int or None
        Exactly so many plain iterations per step; with None, as many as it takes.
    tolerance : float
        Change at which iterations end, relative to nominal value plus size. Where steps are chosen
        by a tolerance, it is 0.3 times that one instead.
    max_iterations : int
        After these a step counts as not converged.
    acceleration : str
        "broyden": quasi-Newton steps on the inputs that are fed back, which converge where loop
        gain times step is beyond 1; "none": plain iterations.
    jumps : str
        What a step is that no length makes as accurate as a tolerance asks. "refuse": the end of
        the run. "pass": a jump that no FMU announces; the shortest step over it is kept, and what
        was before it is forgotten. A value that changes by more than twice what its derivatives
        explain counts as jumping, too.
    control : str
        How the error of a step is found where a tolerance chooses it and an input cannot follow the
        cubic, or a source has no derivative. "halves": the step is made again in two halves, and
        the difference tells. "prediction": as by `Derivative`; with one iteration, FMUs need not
        save their state.

    Examples
    --------
    >>> system = cg.load_scenario("scenarios/scalar.toml").system
    >>> cg.simulate(system, stop_time=0.5, step=0.05, coupling=cg.Hermite(order=6)).status.name
    'COMPLETED'
    """

    order: int | None = None
    iterations: int | None = None
    tolerance: float = 1e-9
    max_iterations: int = 12
    acceleration: str = "broyden"
    jumps: str = "refuse"
    control: str = "halves"
    name: ClassVar[str] = "hermite"
    needs_derivatives: ClassVar[bool] = True
    lands_on_events: ClassVar[bool] = True
    takes_tolerance: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.acceleration not in ACCELERATIONS:
            valid = ", ".join(ACCELERATIONS)
            raise InvalidInput(f"acceleration '{self.acceleration}'; valid: {valid}")
        if self.jumps not in JUMPS:
            raise InvalidInput(f"jumps '{self.jumps}'; valid: {', '.join(JUMPS)}")
        if self.control not in CONTROLS:
            raise InvalidInput(f"control '{self.control}'; valid: {', '.join(CONTROLS)}")
        if self.order not in (None, LOW, HIGH):
            raise InvalidInput(f"order {self.order}; valid: {LOW}, {HIGH}")
        for name in ("iterations", "max_iterations"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise InvalidInput(f"{name} {value}: at least 1 is needed")
        if not 0.0 < self.tolerance < 1.0:
            raise InvalidInput(
                f"tolerance {self.tolerance:g} of the iterations must lie between 0 and 1"
            )

    @property
    def rolls_back(self) -> bool:
        """Every iteration but the first repeats the step."""
        return self.iterations != 1

    @property
    def periods(self) -> Mapping[str, float]:
        """None."""
        return {}

    def stepper(
        self, ensemble: Ensemble, exchange: Exchange, tolerance: float | None
    ) -> AdaptiveStepper[HermiteState]:
        """This coupling at work.

        Raises
        ------
        InvalidInput
            Order 6 for a connection that cannot have it.
        """
        return HermiteStepper(ensemble, self, tolerance)


class HermiteStepper(AdaptiveStepper[HermiteState]):
    """`hermite` at work."""

    def __init__(self, ensemble: Ensemble, coupling: Hermite, tolerance: float | None) -> None:
        self._ensemble = ensemble
        self._coupling = coupling
        self._tolerance = tolerance
        self._saves = coupling.rolls_back and tolerance is None
        self._accelerates = coupling.acceleration == "broyden"
        self._reader = LinkReader(ensemble)
        self.first_change = FIRST_CHANGE
        self._highest = self._highest_order()
        low = bool((ensemble.order < MAX_DERIVATIVE).any() or self._reader.inexact.size)
        self.predicts = low and tolerance is not None and coupling.control == "prediction"
        self.halves = low and not self.predicts
        self.keeps = self.predicts or coupling.jumps == "pass"
        self._passes = tolerance is not None and coupling.jumps == "pass"
        self.order = HELD if low else LOW
        self._accuracy = coupling.tolerance
        if tolerance is not None:
            self._accuracy = tolerance * (SHARE_OF_HALVED if low else SHARE_OF_TOLERANCE)
        self._unsettled = self._accuracy
        if tolerance is not None:
            self._unsettled = tolerance * SHARE_OF_TOLERANCE
        self._feedback = Feedback(ensemble)
        # Ends of inputs from slaves before their target are known once these have stepped, and
        # enter the polynomials of the same iteration.
        slaves, links = range(len(ensemble.slaves)), ensemble.links
        forward = [np.array([k.source == m < k.target for k in links], bool) for m in slaves]
        self._forward = [mask if mask.any() else None for mask in forward]
        # Inputs that take fewer than three derivatives.
        order = ensemble.order
        self._held = [bool((order[columns] == 0).any()) for columns in ensemble.columns]
        self._low = order == 0, order == 1, order == 2
        self._is_low = bool((order < MAX_DERIVATIVE).any())
        self._largest = 0.0
        self.iterations = 0
        self.calls_per_iteration = (
            sum(ensemble.write_calls)
            + len(ensemble.slaves)
            + sum(ensemble.read_calls)
            + 2 * sum(self._held)
        )

    def plan(self) -> HermitePlan:
        """The same as data."""
        coupling = self._coupling
        none = np.zeros(len(self._ensemble.links), bool)
        return HermitePlan(
            self.halves,
            self._saves,
            self._highest,
            coupling.order is None and self._tolerance is not None,
            self._accelerates,
            coupling.max_iterations,
            coupling.iterations or 0,
            self._accuracy,
            self._unsettled,
            self._held,
            self._feedback.start,
            np.array([none if mask is None else mask for mask in self._forward]),
        )

    def _highest_order(self) -> int:
        """The highest order that steps may have."""
        unfit = self._ensemble.order < MAX_DERIVATIVE
        unfit[self._reader.inexact] = True
        wanted = self._coupling.order
        if wanted == HIGH and unfit.any():
            link = self._ensemble.links[int(unfit.argmax())]
            raise InvalidInput(
                f"coupling '{self._coupling.name}': order {HIGH} needs a derivative of the source "
                f"and an input that takes three; the connection {link.name} is without"
            )
        if wanted is not None:
            return wanted
        return LOW if self._tolerance is None or unfit.any() else HIGH

    def renew(self) -> None:
        super().renew()
        self._largest = 0.0

    def start(self, time: float, before: HermiteState | None) -> HermiteState:
        points = Points.begun(time, self._reader.start())
        if before is None:
            count = len(self._feedback.given)
            return HermiteState(points, self._highest, np.zeros((count, count)), 0.0)
        # What was learnt of an iteration outlasts a jump.
        return HermiteState(points, self._highest, before.J, before.length)

    def advance(self, state: HermiteState, time: float, end: float) -> HermiteState:
        if self._saves:
            self._ensemble.save()
        trial = self.attempt(state, time, end)
        if not math.isfinite(trial.error):
            raise RunEnded(
                Status.NOT_CONVERGED,
                f"the step from t = {time:.9g} to {end:.9g}: iterations left the connection "
                f"{self._ensemble.links[trial.worst].name} changing "
                f"(at most {self._coupling.max_iterations} are made)",
            )
        self._largest = max(self._largest, trial.error)
        settle_discrete(self._ensemble, end)
        return trial.state

    def attempt(self, state: HermiteState, time: float, end: float) -> Trial[HermiteState]:
        """Iterate until the ends that are fed back settle, and estimate the error."""
        piece = opened(state.points, end, state.order, self._reader)
        found = self._settled(state, piece, time, end)
        if isinstance(found, Trial):
            return found
        new, J = found
        length = end - time
        points = state.points.followed(end, new)
        if not new.size:
            return Trial(HermiteState(points, self._highest, J, length), 0.0, LOW, 0)
        if self.predicts:
            value, slope = state.points.now
            missed = np.abs(value + length * slope - new[0])
            error, worst = self._relative(missed, new)
            return Trial(HermiteState(points, LOW, J, length), error, HELD, worst, missed)
        distances = estimated_error(
            piece, state.points, end, new, high=self._highest == HIGH, jumps=self._passes
        )
        low, worst = self._relative(distances[0], new)
        order, next_order = LOW, self._highest
        error = low
        if distances[1] is not None:
            high, high_worst = self._relative(distances[1], new)
            if self._tolerance is not None and self._coupling.order is None:
                next_order = order_of_longer_step(low / self._tolerance, high / self._tolerance)
            if state.order == HIGH:
                error, order, worst = high, HIGH, high_worst
        return Trial(HermiteState(points, next_order, J, length), error, order, worst)

    def _settled(
        self, state: HermiteState, piece: Piece, time: float, end: float
    ) -> tuple[Floats, Floats] | Trial[HermiteState]:
        """Values and derivatives at the end that agree with the inputs, shape (2, L), and what was
        learnt of J; or a trial that says that the iterations did not settle."""
        coupling, feedback = self._coupling, self._feedback
        length = end - time
        w = piece.data.reshape(-1)
        scales = feedback.scales(piece.data, length)
        # What an input's end does to an output grows with the step, to first order.
        J = state.J * (length / state.length) if state.length > 0.0 else state.J
        z_before = r_before = None
        change_before = math.inf
        for count in range(1, (coupling.iterations or coupling.max_iterations) + 1):
            if count > 1:
                self._ensemble.restore()
            try:
                new = self._iterated(piece, state.points, time, end)
            except StepDiscarded:
                # Not by the step itself, which the first iteration could make, but by where later
                # ones have led. Where a step may be kept whatever its error, it must at least have
                # been made by all: the components are at different times now.
                may_be_kept = self.keeps and self._tolerance is not None
                if z_before is None or r_before is None or may_be_kept:
                    raise
                return Trial(state, math.inf, LOW, feedback.worst(r_before))
            g = new.reshape(-1).take(feedback.found)
            given = w.take(feedback.given)
            z, r = given / scales, (g - given) / scales
            change = float(np.sqrt(np.cumsum(r * r)[-1])) if r.size else 0.0
            if not math.isfinite(change):
                if count == 1:
                    self._ensemble.check(end)
                return Trial(state, math.inf, LOW, feedback.worst(r))
            accelerates = self._accelerates and len(z) > 0
            if accelerates and z_before is not None and r_before is not None:
                J = learnt(J, z - z_before, r - r_before)
            z_before, r_before = z, r
            if coupling.iterations is None and (
                change <= self._accuracy
                # The FMUs' own accuracy may leave a change that no iteration betters.
                or (change <= self._unsettled and change > change_before / 2.0)
            ):
                return new, J
            change_before = change
            if coupling.iterations is None and accelerates:
                w[feedback.given] = (z + broyden_step(J, r)) * scales
            else:
                w[feedback.given] = g
        if coupling.iterations is None:
            return Trial(state, math.inf, LOW, feedback.worst(r))
        return new, J

    def _iterated(self, piece: Piece, points: Points, time: float, end: float) -> Floats:
        """All slaves once over the step, with the inputs' ends as they are known by now; values
        and derivatives at the end, shape (2, L)."""
        ensemble, length = self._ensemble, end - time
        for m, slave in enumerate(ensemble.slaves):
            ensemble.C[:] = product(piece.matrix, piece.data)
            if self._is_low:
                self._lower(piece.data, length)
            ensemble.write[m]()
            slave.step(time, length)
            ensemble.read[m]()
            if self._held[m]:
                # Outputs for the inputs' values at the end, not those held over the step.
                ensemble.C[0] = piece.data[2]
                ensemble.C[1:] = 0.0
                ensemble.write[m]()
                ensemble.read[m]()
            new = self._reader.end(points, end, piece.data)
            forward = self._forward[m]
            if forward is not None:
                np.copyto(piece.data[2:4], new, where=forward)
        self.iterations += 1
        return new

    def _lower(self, w: Floats, length: float) -> None:
        """Polynomials for inputs that take fewer than three derivatives: the cubic's mean, the
        chord, and the parabola through both ends and the first derivative."""
        C = self._ensemble.C
        held, linear, quadratic = self._low
        mean = (w[0] + w[2]) / 2.0 + (w[1] - w[3]) * (length / 12.0)
        C[0, held] = mean[held]
        C[1, linear] = (w[2, linear] - w[0, linear]) / length
        rise = w[2, quadratic] - w[0, quadratic] - length * w[1, quadratic]
        C[2, quadratic] = 2.0 * rise / (length * length)

    def _relative(self, distance: Floats, new: Floats) -> tuple[float, int]:
        """The largest of distances, shape (L,), relative to nominal value plus size; and whose."""
        relative = self._reader.relative(distance, new[0])
        worst = int(relative.argmax())
        return float(relative[worst]), worst

    def points(self, state: HermiteState) -> Points:
        return state.points

    def first_step(self, state: HermiteState) -> float:
        if self.predicts and self._reader.inexact.size:
            return 0.0  # nothing is known before a step is made
        return self._reader.time_scale(state.points.now) * self.first_change

    def largest_error(self) -> float:
        return self._largest
