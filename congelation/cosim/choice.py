"""The coupling that a run gets where none is stated: what its FMUs declare, tried out."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

from congelation.cosim.abilities import SLOPES, Lack
from congelation.cosim.experiment import Experiment, require_resolved_periods, slave_tolerance
from congelation.cosim.pool import SlavePool
from congelation.cosim.result import Result
from congelation.cosim.system import Member, ResolvedSystem, System
from congelation.cosim.trial import Trial, label
from congelation.errors import InvalidInput

__all__ = ["Choice", "Lack", "chosen", "without"]


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
    tolerance : float or None
        The one that was given and that fixed steps stand in for.
    passes, calls : int
        Of the trial: passes over all components, and fmi2 calls.
    """

    experiment: Experiment
    lacks: tuple[Lack, ...]
    line: str
    tolerance: float | None
    passes: int
    calls: int

    def added_to(self, result: Result) -> Result:
        """The result of the run, with the trial's passes and calls and the reason of the choice."""
        spent = replace(
            result.statistics,
            iterations=result.statistics.iterations + self.passes,
            fmi_calls=result.statistics.fmi_calls + self.calls,
        )
        message = result.message
        found = spent.estimated_error
        if result.completed and self.tolerance is not None and found > self.tolerance:
            message += (
                f" The tolerance of {self.tolerance:g} is not kept, as not all FMUs take other "
                f"steps: the estimated error is {found:.2g}."
            )
        return replace(result, message=message, statistics=spent, choice=self.line)


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
    steps = calls = 0
    with ExitStack() as stack:
        stack.callback(os.chdir, os.getcwd())  # an FMU may leave it
        lender = pool.trials if pool is not None else stack.enter_context(SlavePool())
        while True:
            found = without(resolved, lacks)
            stepped = _with_step(found, experiment)
            trial = Trial(found, stepped)
            trial.run(lender)
            steps += trial.steps
            calls += trial.calls
            if trial.lack is None:
                break
            lacks += (trial.lack,)
    parts = [f"auto: {label(trial.coupling)}, as {trial.why}", *map(str, lacks)]
    if stepped.tolerance != experiment.tolerance:
        parts.append(f"steps of {stepped.step:g} s, as not all FMUs take others")
    passes = math.ceil(steps / max(len(resolved.members), 1))
    unkept = experiment.tolerance if stepped.tolerance is None else None
    to_run = replace(stepped, coupling=trial.coupling)
    return Choice(to_run, lacks, "; ".join(parts), unkept, passes, calls)


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
