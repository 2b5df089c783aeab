"""The inputs and parameters that do most harm to any FMUs, by runs alone.

An input is driven by an FMU that puts out a table: ScalarPlant, whose theta[1](t) is a profile,
jumps included. A parameter is held. Nothing is known of how they enter, so values inside their
bounds are tried too, and the search is CMA-ES. A find is run again ten times as accurately, and
dropped where the two differ.
"""

from __future__ import annotations

import math
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from congelation.cosim.master import simulate
from congelation.cosim.pool import SlavePool
from congelation.cosim.result import Result
from congelation.cosim.system import System
from congelation.design.attack_problem import Admissible, Varied, chosen_variants
from congelation.design.derivative_free import maximise
from congelation.design.finds import DIFFERENCE, Attack, Find
from congelation.design.found_scenario import driven
from congelation.design.shooting import Cells
from congelation.errors import InvalidInput, counted, nearest
from congelation.fmi.description import describe
from congelation.scenario.metrics import metric
from congelation.scenario.scenario import Experiment, MetricSpec, Scenario

__all__ = ["attack_fmus"]


RUNS = 300
"""Runs of one search at effort 1."""

FINER = 0.1
"""Factor on the tolerance and the step in the run that verifies a find."""

SOURCE = "ScalarPlant.fmu"


def attack_fmus(
    scenario: Scenario,
    vary: Mapping[str, tuple[float, float]],
    *,
    objectives: Sequence[str],
    variants: Sequence[str] | None = None,
    effort: float = 1.0,
    seed: int = 0,
    source: Path = Path("fmus") / SOURCE,
    progress: Callable[[str, str, float, float], None] = lambda variant, objective, done, best: (
        None
    ),
) -> Attack:
    """Search for the values of inputs and parameters that make metrics of a scenario large.

    Parameters
    ----------
    scenario : Scenario
        Of any FMUs.
    vary : mapping
        Bounds by ``component.variable``: an input that nothing drives, or a parameter.
    objectives : sequence of str
        Names of the scenario's metrics.
    variants : sequence of str, optional
        Names; all where left out.
    effort : float
        1 is 300 runs for each variant and objective.
    seed : int
    source : Path
        The built ScalarPlant, which drives inputs.
    progress : callable
        Called with variant, objective, the fraction done and the largest value so far.

    Raises
    ------
    InvalidInput
        A variable, metric or variant that there is not, bounds in the wrong order, an input that is
        driven.
    """
    varied = [_varied(scenario, name, bounds) for name, bounds in vary.items()]
    if not varied:
        raise InvalidInput("nothing is to be varied; give bounds of an input or a parameter")
    if any(one.is_input for one in varied) and not source.is_file():
        raise InvalidInput(f"{source} is needed to drive inputs; build it with: make fmus")
    if not objectives:
        raise InvalidInput("no objective; name a metric of the scenario")
    specs = {spec.name: spec for spec in scenario.metrics if not metric(spec.metric).loop}
    for name in objectives:
        if name not in specs:
            raise InvalidInput(f"'{name}' is no metric of a group; {nearest(name, list(specs))}")
    finds: list[Find] = []
    missed: list[str] = []
    notes: list[str] = []
    for variant in chosen_variants(scenario, variants):
        for name in objectives:
            with SlavePool() as pool, tempfile.TemporaryDirectory() as folder:
                by_runs = _SearchByRuns(
                    scenario, variant, varied, specs[name], source, pool, Path(folder)
                )
                found = by_runs.search(int(RUNS * effort), seed, progress)
            notes += by_runs.notes
            if isinstance(found, Find):
                finds.append(found)
            else:
                missed.append(found)
    return Attack(scenario, tuple(finds), tuple(missed), tuple(varied), source, tuple(notes))


class _SearchByRuns:
    """One variant and metric, and the runs of a search."""

    def __init__(
        self,
        scenario: Scenario,
        variant: str,
        vary: Sequence[Varied],
        spec: MetricSpec,
        source: Path,
        pool: SlavePool,
        folder: Path,
    ) -> None:
        settings = next(v.settings for v in scenario.variants if v.name == variant)
        self._case = scenario.case(settings)
        self._variant, self._vary, self._spec = variant, vary, spec
        self._source, self._pool, self._folder = source, pool, folder
        self._runs = 0
        self._failures: Counter[str] = Counter()

    @property
    def notes(self) -> list[str]:
        """One line on runs that say nothing, as they did not reach the stop time."""
        if not self._failures:
            return []
        ((message, _),) = self._failures.most_common(1)
        return [
            f"{self._variant}: {self._spec.name}: {self._failures.total()} of "
            f"{counted(self._runs, 'run')} did not reach the stop time, and their values were "
            f"passed over; most often: {message}"
        ]

    def search(
        self, runs: int, seed: int, progress: Callable[[str, str, float, float], None]
    ) -> Find | str:
        """The best find that stands in a finer run, or a line that says why there is none."""
        low, high = (np.array([getattr(v, end) for v in self._vary]) for end in ("low", "high"))
        admissible = Admissible((low + high) / 2, (high - low) / 2)
        experiment = self._case.experiment
        for cells in maximise(
            self._value,
            admissible,
            (experiment.start_time, experiment.stop_time),
            seed=seed,
            more=lambda: self._runs < runs,
            progress=lambda best: progress(
                self._variant, self._spec.name, min(1.0, self._runs / runs), best
            ),
            inside=True,
            constant=np.array([not v.is_input for v in self._vary]),
        ):
            value, finer = self._value(cells), self._value(cells, FINER)
            difference = 0.0 if value == finer else abs(finer - value) / max(abs(finer), 1e-300)
            if difference <= DIFFERENCE:
                return Find(
                    variant=self._variant,
                    objective=self._spec.name,
                    plant="",
                    value=finer,
                    cells=cells,
                    difference=difference,
                    margin=math.nan,
                    certified=False,
                    bound=None,
                )
        return (
            f"{self._variant}: {self._spec.name}: no candidate was confirmed by a finer run; "
            "shorten the step or the tolerance of the scenario"
        )

    def _value(self, cells: Cells, finer: float = 1.0) -> float:
        """The metric of a run; nan where it did not reach its stop time."""
        self._runs += 1
        stem = f"run_{self._runs}"
        system, _ = driven(self._case.system, cells, self._vary, self._source, self._folder, stem)
        result = _run(system, self._case.experiment, self._spec, finer, self._pool)
        if not result.completed:
            self._failures[result.message] += 1
            return math.nan
        found = metric(self._spec.metric).function(result.time, result.values, **self._spec.options)
        return math.nan if found is None else float(found)


def _run(
    system: System, experiment: Experiment, spec: MetricSpec, finer: float, pool: SlavePool
) -> Result:
    step, tolerance = experiment.step, experiment.tolerance
    return simulate(
        system,
        start_time=experiment.start_time,
        stop_time=experiment.stop_time,
        step=None if step is None else finer * step,
        tolerance=None if tolerance is None else finer * tolerance,
        coupling=experiment.coupling,
        options=experiment.options,
        record=[spec.of],
        slave_tolerance=None
        if experiment.slave_tolerance is None
        else finer * experiment.slave_tolerance,
        pool=pool,
    )


def _varied(scenario: Scenario, name: str, bounds: tuple[float, float]) -> Varied:
    owner, _, variable = name.partition(".")
    components = {c.name: c for c in scenario.system.components}
    if owner not in components:
        raise InvalidInput(f"'{name}': no component '{owner}'; {nearest(owner, list(components))}")
    variables = describe(Path(components[owner].fmu)).variables
    real = [n for n, v in variables.items() if v.type == "Real" and v.causality in _VARIED]
    if variable not in real:
        raise InvalidInput(f"'{name}' is no Real input or parameter; {nearest(variable, real)}")
    low, high = bounds
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InvalidInput(f"'{name}' from {low:g} to {high:g}; give a lower and a higher number")
    is_input = variables[variable].causality == "input"
    resolved = scenario.system.resolve()
    for link in resolved.links:
        if (resolved.members[link.target].name, link.input.name) == (owner, variable):
            raise InvalidInput(f"'{name}' is driven by '{link.name}'; vary an input that is free")
    return Varied(owner, variable, low, high, is_input)


_VARIED = ("input", "parameter")
