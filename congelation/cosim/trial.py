"""The trial before a run: which coupling errs least, of those that the FMUs can take.

It makes a few steps with instances of its own, none of which is lent to the run: an FMU whose reset
is incomplete would begin the run from what the trial has left.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from congelation.cosim.abilities import (
    LENGTHS,
    REFUSED_LENGTH,
    REFUSED_STATE,
    STATES,
    Abilities,
    Lack,
    lack_of,
)
from congelation.cosim.columns import Columns
from congelation.cosim.coupling import Coupling, Derivative, GaussSeidel, Hermite, Stepper
from congelation.cosim.coupling.points import Points
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import settle_discrete
from congelation.cosim.experiment import Experiment, divides, slave_tolerance, step_count
from congelation.cosim.pool import SlavePool
from congelation.cosim.result import RunEnded
from congelation.cosim.session import Session
from congelation.cosim.step_size import DECIDED, SMALLEST_ERROR
from congelation.cosim.system import MAX_DERIVATIVE, ResolvedSystem
from congelation.errors import SlaveError
from congelation.fmi.slave import SlaveTerminated

__all__ = ["Trial", "label"]


SHARE = 1e-3
"""Length of the steps that are tried, as a part of the horizon, if the experiment gives none."""

BEFORE_JUMP = 0.25
"""Part of the time to the first announced jump after which a tried step ends."""

MOST_STEPS, PART = 20, 0.05
"""Steps that are made before couplings are compared, at most, and as a part of the run."""

SHOWN = 10
"""Steps after which extrapolated inputs must be nearer to their sources than held ones: where
extrapolation is unstable, its errors have grown by then."""

DOUBTFUL = 0.3
"""From this distance of extrapolated inputs on, over that of held ones, another sequence is tried.
Over the coupling problems it is up to 0.16 where all is well, and 0.5 and 3 where errors grow."""

WORTH = 200
"""Steps of a run for which a comparison, of about 15 passes, is worth its price."""

GROWTH = 10.0
"""By so much steps grow, at most, until their errors show, where a tolerance chooses them."""

EVEN_STEPS = 3
"""Steps of that length then, so that derivatives come from past values as in a run."""

FIRST, LAST = 1e-5, 1e-2
"""The first of those steps, and the longest, as parts of the horizon."""

ORDER = 2
"""Of the couplings that are compared: with n passes a step, a coupling has steps n times as long
as one with one pass has at its price, and an error n^2 times that."""

MARGIN = 10.0
"""By so much iterations must be better in a tried step, as others are not as they are in it: where
solutions oscillate, errors of extrapolation cancel in part, and the first steps are no whole run.
Over the coupling problems, those in which iterations were better by 10 to 400 times at the end were
better by 20 to 90 in a tried step; where that was 4, they were worse by 4 to 8 at the end."""

SEQUENCES = (Derivative(control="prediction"), Derivative("jacobi", "prediction"))
"""Extrapolated inputs, with and without what components before have done in the same step."""


class Trial:
    """A few steps of a system, from its start.

    Parameters
    ----------
    system : ResolvedSystem
    experiment : Experiment
        Its coupling is not looked at.

    Attributes
    ----------
    lack : Lack or None
        The first ability that was found to be missing; the trial ends there.
    coupling : Coupling
        The most accurate one, there once the trial is over.
    why : str
        Why it is that.
    steps, calls : int
        fmi2DoStep calls, and all fmi2 calls.
    """

    coupling: Coupling
    why: str

    def __init__(self, system: ResolvedSystem, experiment: Experiment) -> None:
        self._system, self._experiment = system, experiment
        declared = [member.description for member in system.members]
        self._saves = all(d.can_get_and_set_state for d in declared)
        cubic = all(system.input_order(link) == MAX_DERIVATIVE for link in system.links)
        slopes = all(system.knows_derivative(link) for link in system.links)
        self._able = self._saves and cubic and slopes
        missing = [
            text
            for text, has in (
                ("can save their state", self._saves),
                ("take polynomials as inputs", cubic),
                ("know derivatives of their outputs", slopes),
            )
            if not has
        ]
        self._missing = f"not all FMUs {' and '.join(missing)}"
        step = experiment.step if experiment.tolerance is None else None
        self._length = step
        self._varies = step is None or not divides(
            experiment.start_time, experiment.stop_time, step
        )
        self.lack: Lack | None = None
        self.steps = self.calls = 0

    def run(self, lender: SlavePool) -> None:
        """Try the FMUs, and find the coupling; up to the first lack.

        An FMU that fails otherwise than by an ability that it lacks leaves the choice to what is
        declared: the run will say what fails.
        """
        # Values that are not finite are looked at by the run, which names them.
        with np.errstate(over="ignore", invalid="ignore"):
            self._find_lack(lender)
            doubt = self.lack
            if doubt is not None and doubt.ability == LENGTHS and self._saves:
                # The step that was refused began from a restored state: either may be the reason.
                self._saves, self.lack = False, None
                self._find_lack(lender)
                if self.lack is None:
                    refused = doubt.shown.replace(REFUSED_LENGTH, REFUSED_STATE)
                    self.lack = doubt._replace(ability=STATES, shown=refused)
            if self.lack is None:
                self._choose(lender)

    def _find_lack(self, lender: SlavePool) -> None:
        try:
            if self._system.links:
                self._try_abilities(lender)
        except (SlaveError, SlaveTerminated, RunEnded) as error:
            self.lack = self.lack or lack_of(error, self._system)

    @contextmanager
    def _begun(self, lender: SlavePool) -> Iterator[tuple[Session, float]]:
        """A session at the start time, and when the first jump is announced."""
        experiment = self._experiment
        start, stop = experiment.start_time, experiment.stop_time
        with lender.lend(self._system.members) as slaves:
            ensemble = Ensemble(
                self._system, slaves, (), derivatives=True, slopes=False, events=True
            )
            columns = Columns(ensemble, (), latched=False)
            session = Session(ensemble, Derivative(), columns, start, stop, None, None)
            session.begin(self._system, (), None)
            try:
                session.initialise(slave_tolerance(experiment))
                yield session, session.next_event(start)
            finally:
                self.calls += ensemble.calls

    def _try_abilities(self, lender: SlavePool) -> None:
        """Find an ability that is declared and missing.

        Raises
        ------
        SlaveError, SlaveTerminated, RunEnded
            What an FMU refuses.
        """
        start, stop = self._experiment.start_time, self._experiment.stop_time
        saves = self._saves and (self._varies or self._able or self._feeds_back)
        tried = Abilities(self._system, saves=saves, varies=self._varies, able=self._able)
        try:
            with self._begun(lender) as (session, jump):
                if self._length is None:
                    h = min(SHARE * (stop - start), BEFORE_JUMP * (jump - start))
                else:
                    # Where lengths have to vary, a step of half the length follows this one.
                    h = min(self._length, (stop - start) / (2.0 if self._varies else 1.0))
                tried.run(session.ensemble, start, h)
        finally:
            self.lack = tried.lack
            self.steps += tried.steps
            self.calls += tried.calls

    @property
    def _feeds_back(self) -> bool:
        """Whether a component gets something from itself, or from one that steps after it."""
        return any(link.source >= link.target for link in self._system.links)

    def _choose(self, lender: SlavePool) -> None:
        chosen = self._length is None
        predicted = ", its steps chosen by how well inputs were predicted" if chosen else ""
        derivative = SEQUENCES[0]
        if not self._system.links:
            self.coupling = Derivative() if chosen else derivative
            self.why = (
                "all values that are exchanged are discrete"
                if self._system.discrete_links
                else "nothing is connected"
            )
            return
        if self._able and (chosen or self._converges(lender)):
            self.coupling = Hermite(jumps="pass")
            self.why = (
                "all FMUs can save their state, take polynomials as inputs and know derivatives "
                "of their outputs"
            )
            return
        if not self._feeds_back and not self._able:
            self.coupling = Hermite(iterations=1, jumps="pass", control="prediction")
            self.why = f"{self._missing}, and none feeds back to one before it{predicted}"
            return
        why = self._missing
        if self._able:
            why = f"iterations do not converge at a step of {self._length:g} s"
        self.coupling, self.why = derivative, why + predicted
        try:
            measured = self._measured(lender, chosen=chosen)
        except (SlaveError, SlaveTerminated, RunEnded):
            return  # the run will say what fails
        if measured is not None:
            self.coupling, found = measured
            self.why = f"{why}, and {found}{predicted}"

    def _converges(self, lender: SlavePool) -> bool:
        """Whether a fixed step of `hermite` does."""
        assert self._length is not None
        start, stop = self._experiment.start_time, self._experiment.stop_time
        try:
            with self._begun(lender) as (session, _):
                stepper = Hermite().stepper(session.ensemble, session.exchange, None)
                try:
                    state = stepper.start(start, None)
                    stepper.advance(state, start, min(start + self._length, stop))
                finally:
                    self._count(stepper)
        except RunEnded:
            return False
        except (SlaveError, SlaveTerminated):
            pass  # the run will say what fails
        return True

    def _measured(self, lender: SlavePool, *, chosen: bool) -> tuple[Coupling, str] | None:
        """The coupling that is better than `derivative`, and why; None where that is best.

        Raises
        ------
        SlaveError, SlaveTerminated, RunEnded
        """
        iterated = Hermite(jumps="pass", control="prediction")
        if chosen:
            ratio = self._chosen_steps(lender, iterated) if self._saves else None
        else:
            sequential, parallel = SEQUENCES
            off, ratio = self._fixed_steps(lender, sequential, iterated)
            if off > DOUBTFUL:
                other, _ = self._fixed_steps(lender, parallel, None)
                if other < min(off, 1.0):
                    return parallel, (
                        f"extrapolated inputs are {off / other:.2g} times nearer to their sources "
                        "where components do not see the ends of each other's steps"
                    )
                if off > 1.0:
                    return GaussSeidel(), "extrapolated inputs are worse than held ones"
        if ratio is None or ratio < MARGIN:
            return None
        return iterated, (
            f"{SEQUENCES[0].name} had {ratio:.2g} times its error in a tried step, at the same "
            "number of fmi2DoStep calls"
        )

    def _fixed_steps(
        self, lender: SlavePool, coupling: Derivative, iterated: Hermite | None
    ) -> tuple[float, float | None]:
        """How far inputs are from their sources, extrapolated over held, after some steps; and what
        `_ratio` is there."""
        start, stop = self._experiment.start_time, self._experiment.stop_time
        assert self._length is not None
        length = min(self._length, stop - start)
        off, ratio = 0.0, None
        with self._begun(lender) as (session, jump):
            ensemble = session.ensemble
            steps = step_count(start, stop, length)
            count = int(min(PART * steps, MOST_STEPS, (min(stop, jump) - start) / length - 1.0))
            stepper = coupling.stepper(ensemble, session.exchange, None)
            state, time = stepper.start(start, None), start
            held = extrapolated = np.zeros(len(ensemble.links))
            try:
                for k in range(count):
                    value, slope = state.now
                    state = stepper.advance(state, time, start + (k + 1) * length)
                    time = start + (k + 1) * length
                    if k >= count / 2:
                        change = state.now[0] - value
                        held = np.maximum(held, np.abs(change))
                        extrapolated = np.maximum(extrapolated, np.abs(change - length * slope))
            finally:
                self._count(stepper)
            scale = ensemble.nominal + np.abs(state.now[0])
            if count >= SHOWN and held.any():
                off = float((extrapolated / scale).max() / (held / scale).max())
            if iterated is not None and self._saves and count >= SHOWN and steps >= WORTH:
                ratio = self._ratio(session, iterated, state, time, length)
        return off, ratio

    def _chosen_steps(self, lender: SlavePool, iterated: Hermite) -> float | None:
        """What `_ratio` is where steps have become as long as a tolerance allows."""
        tolerance = self._experiment.tolerance
        assert tolerance is not None
        start, stop = self._experiment.start_time, self._experiment.stop_time
        with self._begun(lender) as (session, jump):
            ensemble = session.ensemble
            stepper = SEQUENCES[0].stepper(ensemble, session.exchange, tolerance)
            state, time = stepper.start(start, None), start
            length, longest = FIRST * (stop - start), LAST * (stop - start)
            try:
                while True:
                    trial = stepper.attempt(state, time, time + length)
                    settle_discrete(ensemble, time + length)
                    state, time = trial.state, time + length
                    error = trial.error / tolerance
                    fits = 1.0 / math.sqrt(max(error, SMALLEST_ERROR))
                    if error >= DECIDED or length >= longest:
                        break
                    length = min(length * min(GROWTH, fits), longest)
                # So long steps are likely to become, be they longer than those that are tried.
                likely = length * fits
                length = min(length, likely)
                if (stop - start) / likely < WORTH or time + (EVEN_STEPS + 1) * length >= jump:
                    return None
                for _ in range(EVEN_STEPS):
                    state = stepper.advance(state, time, time + length)
                    time += length
            finally:
                self._count(stepper)
            return self._ratio(session, iterated, state, time, length)

    def _ratio(
        self, session: Session, iterated: Hermite, points: Points, time: float, length: float
    ) -> float | None:
        """The error of a step by `derivative` over that of iterations at the same price, from here;
        None where these do not converge. What is true comes from two half steps."""
        ensemble, tolerance = session.ensemble, self._experiment.tolerance
        before, end, middle = ensemble.Y.copy(), time + length, time + length / 2.0
        stepper = iterated.stepper(ensemble, session.exchange, tolerance)
        single = SEQUENCES[0].stepper(ensemble, session.exchange, tolerance)
        state = stepper.start(time, None)._replace(points=points)
        ensemble.save()
        try:
            first = stepper.attempt(state, time, middle)
            ensemble.level = 1
            ensemble.save()
            second = stepper.attempt(first.state, middle, end)
            halves = ensemble.Y[ensemble.source]
            ensemble.level = 0
            ensemble.restore()
            ensemble.Y[:] = before
            # With what the halves have learnt of the loop, as in a run.
            made = stepper.iterations
            state = state._replace(J=second.state.J, length=second.state.length)
            whole = stepper.attempt(state, time, end)
            found = ensemble.Y[ensemble.source]
            price = (stepper.iterations - made) ** ORDER
            ensemble.restore()
            ensemble.Y[:] = before
            single.attempt(points, time, end)
            predicted = ensemble.Y[ensemble.source]
        finally:
            self._count(stepper)
            self._count(single)
        if not all(math.isfinite(trial.error) for trial in (first, second, whole)):
            return None
        exact = halves + (halves - found) / (2.0**ORDER - 1.0)
        scale = ensemble.nominal + np.abs(exact)
        errors = [float((np.abs(v - exact) / scale).max()) for v in (predicted, found)]
        return errors[0] / (errors[1] * price) if errors[1] > 0.0 else None

    def _count(self, stepper: Stepper[Any]) -> None:
        self.steps += stepper.iterations * len(self._system.members)
        self.calls += stepper.iterations * stepper.calls_per_iteration


def label(coupling: Coupling) -> str:
    """The name of a coupling, with its sequence where that is not the usual one."""
    if isinstance(coupling, Derivative) and coupling.sequence != Derivative.sequence:
        return f"{coupling.name} ({coupling.sequence})"
    return coupling.name
