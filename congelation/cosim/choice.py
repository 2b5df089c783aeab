"""The coupling that a run gets where none is stated: what its FMUs declare, tried out.

The trial makes a few steps with instances of its own, which are freed before the run begins. Only
where the caller lends instances from run to run, as studies do, are these tried, and reset as they
are between any two runs.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling import Coupling, Derivative, GaussSeidel, Hermite
from congelation.cosim.ensemble import NO_DERIVATIVE, Ensemble
from congelation.cosim.exchange import Exchange
from congelation.cosim.experiment import (
    Experiment,
    divides,
    require_resolved_periods,
    slave_tolerance,
)
from congelation.cosim.pool import SlavePool
from congelation.cosim.recording import Columns
from congelation.cosim.result import Result, RunEnded
from congelation.cosim.session import Session
from congelation.cosim.system import MAX_DERIVATIVE, Member, ResolvedSystem, System
from congelation.errors import InvalidInput, SlaveError
from congelation.fmi.slave import Slave, SlaveTerminated

__all__ = ["Choice", "Lack", "chosen", "without"]

Floats = npt.NDArray[np.float64]

SHARE = 1e-3
"""Length of the steps that are tried, as a part of the horizon, if the experiment gives none."""

BEFORE_JUMP = 0.25
"""Part of the time to the first announced jump after which the trial ends."""

LOOKED_AHEAD, LEAST_AHEAD, PART = 20, 10, 0.1
"""Steps of one length, at most, at least, and of the run, after which extrapolation must do better
than holding inputs: where it is unstable, its errors have grown by then."""

REPEATED = 0.5
"""Largest difference of a step from a restored state, relative to what the step changes; beyond it,
the state was not restored."""

HALF_WAY = 0.2
"""The same for a step of half the length."""

REFUSED_LENGTH = "refuses the second one"

ROUNDING = 1e-6
"""Relative changes up to this size show nothing."""

STATES, SLOPES = "can_get_and_set_state", "max_output_derivative_order"
CUBICS, LENGTHS = "can_interpolate_inputs", "can_vary_step"

ABILITIES = MappingProxyType(
    {
        STATES: "states that can be saved and restored",
        SLOPES: "derivatives of its outputs",
        CUBICS: "inputs that follow polynomials",
        LENGTHS: "steps of any length",
    }
)
"""Abilities that an FMU may declare, by the name of their fields in its description."""

CALLED = MappingProxyType(
    {
        "fmi2GetFMUstate": STATES,
        "fmi2SetFMUstate": STATES,
        "fmi2FreeFMUstate": STATES,
        "fmi2GetRealOutputDerivatives": SLOPES,
        "fmi2SetRealInputDerivatives": CUBICS,
    }
)
"""The functions that go with an ability."""


class Lack(NamedTuple):
    """An ability that an FMU declares and does not have.

    Parameters
    ----------
    component : str
    ability : str
        One of `ABILITIES`.
    shown : str
        What the trial showed.
    """

    component: str
    ability: str
    shown: str

    def __str__(self) -> str:
        return f"{self.component} declares {ABILITIES[self.ability]}, but {self.shown}"


@dataclass(frozen=True)
class Choice:
    """The coupling that was chosen for a run, and what is known of its FMUs.

    Parameters
    ----------
    experiment : Experiment
        With the coupling that was found.
    lacks : tuple of Lack
        Abilities that FMUs declare and that the run does not use.
    line : str
        Which coupling, and why.
    passes, calls : int
        Of the trial: passes over all components, and fmi2 calls.
    """

    experiment: Experiment
    lacks: tuple[Lack, ...]
    line: str
    passes: int
    calls: int

    def added_to(self, result: Result) -> Result:
        """The result of the run, with the trial's passes and calls and the reason of the choice."""
        spent = replace(
            result.statistics,
            iterations=result.statistics.iterations + self.passes,
            fmi_calls=result.statistics.fmi_calls + self.calls,
        )
        return replace(result, statistics=spent, choice=self.line)


def without(system: ResolvedSystem, lacks: Sequence[Lack]) -> ResolvedSystem:
    """A system whose FMUs do not declare what they lack."""

    def corrected(member: Member) -> Member:
        description = member.description
        for lack in lacks:
            if lack.component == member.name:
                gone: dict[str, Any] = {lack.ability: 0 if lack.ability == SLOPES else False}
                description = replace(description, **gone)
        return replace(member, description=description)

    return replace(system, members=tuple(map(corrected, system.members))) if lacks else system


def chosen(system: System, experiment: Experiment, pool: SlavePool | None = None) -> Choice:
    """Find the most accurate coupling that the FMUs of a system allow.

    Parameters
    ----------
    system : System
    experiment : Experiment
        Its coupling is not looked at.
    pool : SlavePool, optional
        Lends the instances; by default they are made, and freed afterwards.

    Returns
    -------
    Choice
        Where an FMU fails in the trial otherwise than by an ability that it lacks, the choice
        follows from what is declared: the run will say what fails.

    Raises
    ------
    InvalidInput
        A tolerance alone for FMUs that take steps of one length and propose none, or what
        `System.resolve` raises.
    """
    require_resolved_periods(experiment, ())
    resolved = system.resolve()
    lacks: tuple[Lack, ...] = ()
    passes = calls = 0
    with ExitStack() as stack:
        stack.callback(os.chdir, os.getcwd())  # an FMU may leave it
        lender = pool if pool is not None else stack.enter_context(SlavePool())
        while True:
            found = without(resolved, lacks)
            stepped = _with_step(found, experiment)
            trial = _Trial(found, stepped)
            try:
                if found.links:
                    with lender.lend(found.members) as slaves:
                        trial.run(slaves)
            except (SlaveError, SlaveTerminated, RunEnded) as error:
                trial.lack = trial.lack or _lack_of(error, found)
            passes += trial.passes
            calls += trial.calls
            if trial.lack is None:
                break
            lacks += (trial.lack,)
    coupling, why = trial.coupling()
    told = [f"auto: {coupling.name}, as {why}", *map(str, lacks)]
    if stepped.tolerance != experiment.tolerance:
        told.append(f"steps of {stepped.step:g} s, as not all FMUs take others")
    return Choice(replace(stepped, coupling=coupling), lacks, "; ".join(told), passes, calls)


def _with_step(system: ResolvedSystem, experiment: Experiment) -> Experiment:
    """The experiment, with a step in place of its tolerance where an FMU takes no other.

    Raises
    ------
    InvalidInput
        There is no step, and the FMUs propose none.
    """
    stiff = [m for m in system.members if not m.description.can_vary_step]
    if experiment.tolerance is None or not stiff:
        return experiment
    proposed = {m.description.proposed_step for m in stiff} - {None}
    if experiment.step is None and len(proposed) != 1:
        first = stiff[0]
        said = "none is proposed" if not proposed else "the FMUs propose different ones"
        raise InvalidInput(
            f"component '{first.name}': {first.description.path.name} takes steps of one length "
            f"only, and {said}; give a step in place of the tolerance"
        )
    return replace(
        experiment,
        step=experiment.step or proposed.pop(),
        tolerance=None,
        slave_tolerance=slave_tolerance(experiment),
    )


def _lack_of(error: Exception, system: ResolvedSystem) -> Lack | None:
    """The ability that an FMU has declared and refuses."""
    ability = CALLED.get(getattr(error, "call", ""))
    if ability is None or not isinstance(error, SlaveError):
        return None
    member = next(m for m in system.members if m.name == error.component)
    if not getattr(member.description, ability):
        return None
    return Lack(member.name, ability, f"refuses {error.call}: {error.message}")


class _Trial:
    """A few steps of a system, from its start.

    Parameters
    ----------
    system : ResolvedSystem
    experiment : Experiment

    Attributes
    ----------
    lack : Lack or None
        The first ability that was found to be missing; the trial ends there.
    passes, calls : int
        As in Choice.
    """

    def __init__(self, system: ResolvedSystem, experiment: Experiment) -> None:
        self._system, self._experiment = system, experiment
        declared = [member.description for member in system.members]
        self._saves = all(d.can_get_and_set_state for d in declared)
        self._cubic = all(system.input_order(link) == MAX_DERIVATIVE for link in system.links)
        self._slopes = all(system.knows_derivative(link) for link in system.links)
        self._converges = self._extrapolates = True
        self.lack: Lack | None = None
        self.passes = self.calls = 0

    def coupling(self) -> tuple[Coupling, str]:
        """The most accurate coupling, and why it is that."""
        chosen = self._experiment.tolerance is not None
        if not self._system.links and not chosen:
            return Derivative(control="prediction"), "no numbers are exchanged"
        missing = [
            text
            for text, has in (
                ("can save their state", self._saves),
                ("take polynomials as inputs", self._cubic),
                ("know derivatives of their outputs", self._slopes),
            )
            if not has
        ]
        if not missing and self._converges:
            return Hermite(jumps="pass"), (
                "all FMUs can save their state, take polynomials as inputs and know derivatives "
                "of their outputs"
            )
        why = f"not all FMUs {' and '.join(missing)}"
        if not missing:
            why = f"iterations do not converge at a step of {self._experiment.step:g} s"
        if not self._extrapolates:
            return GaussSeidel(), f"{why}, and extrapolated inputs are worse than held ones"
        how = ", its steps chosen by how well inputs were predicted" if chosen else ""
        return Derivative(control="prediction"), why + how

    def run(self, slaves: Sequence[Slave]) -> None:
        """Try what matters for the choice, up to the first lack.

        Raises
        ------
        SlaveError, SlaveTerminated, RunEnded
            What ended the trial; `lack` is set where that tells of one.
        """
        experiment = self._experiment
        ensemble = Ensemble(self._system, slaves, (), derivatives=True, slopes=False, events=True)
        start, stop = experiment.start_time, experiment.stop_time
        columns = Columns(ensemble, (), latched=False)
        session = Session(ensemble, Derivative(), columns, start, stop, None, None)
        session.begin(self._system, (), None)
        try:
            session.initialise(slave_tolerance(experiment))
            self._steps(ensemble, session.next_event(start))
        finally:
            self.calls += ensemble.calls

    def _steps(self, ensemble: Ensemble, jump: float) -> None:
        experiment = self._experiment
        start, stop = experiment.start_time, experiment.stop_time
        step = experiment.step if experiment.tolerance is None else None
        varies = step is None or not divides(start, stop, step)
        if step is None:
            h = min(SHARE * (stop - start), BEFORE_JUMP * (jump - start))
        else:
            # Where lengths have to vary, a second step of half the length ends before the stop.
            h = min(step, (stop - start) / 2 if varies else stop - start)
        ensemble.C[:] = 0.0
        ensemble.C[0] = ensemble.Y[ensemble.source]
        known = ensemble.source_derivative != NO_DERIVATIVE
        ensemble.C[1, known] = ensemble.Y[ensemble.source_derivative[known]]
        before = ensemble.Y.copy()
        if self._saves:
            ensemble.save()
        self._pass(ensemble, start, h)
        after = ensemble.Y.copy()
        self.lack = self._flat(ensemble, before, after)
        if self.lack is None and self._saves:
            ensemble.restore()
            ensemble.read_all()
            ensemble.calls += sum(ensemble.read_calls)
            if varies and self._unlike(ensemble, before, before, ROUNDING) is None:
                # A step of half the length shows both that the state is restored and that lengths
                # may vary, where it ends half way.
                self._pass(ensemble, start, h / 2.0, LENGTHS, REFUSED_LENGTH)
                middle = (before + after) / 2.0
                if self._unlike(ensemble, before, middle, HALF_WAY) is None:
                    return
                ensemble.restore()
            self._pass(ensemble, start, h, STATES, "steps from a restored one are refused")
            self.lack = self._unlike(ensemble, before, after, REPEATED)
        if self.lack is not None:
            return
        if varies:
            self._pass(ensemble, start + h, h / 2.0, LENGTHS, REFUSED_LENGTH)
        elif not (self._saves and self._cubic and self._slopes):
            self._extrapolated(ensemble, start + h, h, min(stop, jump))
        else:
            ensemble.restore()
            ensemble.Y[:] = before
            stepper = Hermite().stepper(ensemble, Exchange(ensemble), None)
            try:
                stepper.advance(stepper.start(start, None), start, start + h)
            except RunEnded:
                self._converges = False
            finally:
                self._count(ensemble, stepper.iterations)

    def _extrapolated(self, ensemble: Ensemble, time: float, length: float, until: float) -> None:
        """Whether inputs are nearer to their sources extrapolated than held, after some steps."""
        horizon = self._experiment.stop_time - self._experiment.start_time
        count = int(min(LOOKED_AHEAD, PART * horizon / length, (until - time) / length))
        if count < LEAST_AHEAD:
            return
        stepper = Derivative().stepper(ensemble, Exchange(ensemble), None)
        state = stepper.start(time, None)
        held = extrapolated = np.zeros(len(ensemble.links))
        for k in range(count):
            value, slope = state.now
            state = stepper.advance(state, time + k * length, time + (k + 1) * length)
            if k >= count / 2:
                change = state.now[0] - value
                held = np.maximum(held, np.abs(change))
                extrapolated = np.maximum(extrapolated, np.abs(change - length * slope))
        self._count(ensemble, stepper.iterations)
        scale = ensemble.nominal + np.abs(state.now[0])
        if len(scale):
            self._extrapolates = bool((extrapolated / scale).max() <= (held / scale).max())

    def _pass(
        self, ensemble: Ensemble, time: float, length: float, ability: str = "", shown: str = ""
    ) -> None:
        """All slaves once over a step, their inputs as they are in C.

        Raises
        ------
        SlaveError
            Where an FMU refuses the step and `ability` is given, `lack` is set to it.
        """
        self._count(ensemble, 1)
        for m, slave in enumerate(ensemble.slaves):
            ensemble.write[m]()
            try:
                slave.step(time, length)
            except SlaveError as error:
                if ability and getattr(self._system.members[m].description, ability):
                    self.lack = Lack(slave.name, ability, f"{shown}: {error.message}")
                raise
            ensemble.read[m]()

    def _count(self, ensemble: Ensemble, passes: int) -> None:
        each = len(ensemble.slaves) + sum(ensemble.write_calls) + sum(ensemble.read_calls)
        self.passes += passes
        self.calls += passes * each

    def _flat(self, ensemble: Ensemble, before: Floats, after: Floats) -> Lack | None:
        """The first FMU whose outputs change while it says that none of their derivatives is
        other than zero."""
        for member in self._system.members:
            own = [
                k
                for k, link in enumerate(ensemble.links)
                if self._system.members[link.source] is member
                and link.source_derivatives[0] is None
                and ensemble.source_derivative[k] != NO_DERIVATIVE
            ]
            values, slopes = ensemble.source[own], ensemble.source_derivative[own]
            change = np.abs(after[values] - before[values])
            said = np.concatenate([before[slopes], after[slopes]])
            moves = change > ROUNDING * (ensemble.nominal[own] + np.abs(before[values]))
            if moves.any() and not said.any():
                return Lack(member.name, SLOPES, "all are zero while its outputs change")
        return None

    def _unlike(
        self, ensemble: Ensemble, before: Floats, after: Floats, share: float
    ) -> Lack | None:
        """The first FMU whose step from the restored state ends elsewhere than the first did, by
        more than a share of what that changed."""
        Y = ensemble.Y
        for k, link in enumerate(ensemble.links):
            place = ensemble.source[k]
            off = abs(Y[place] - after[place])
            least = ROUNDING * (ensemble.nominal[k] + abs(after[place]))
            if off > max(share * abs(after[place] - before[place]), least):
                return Lack(
                    self._system.members[link.source].name,
                    STATES,
                    f"a step from a restored one ends with {link.output.name} = {Y[place]:.6g} in "
                    f"place of {after[place]:.6g}",
                )
        return None
