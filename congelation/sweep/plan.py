"""Plans: what a study consists of, what of it is finished, and what each run is identified by.

The runs of a plan are computed by their numbers as they are needed, and of all of them only the
run_ids are held, so a plan of a million runs takes little memory. The store keeps these, so that a
study is resumed without computing them again. `run` plans the variants of a scenario, `sweep` every
variant at every point of its sweep.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, cast

from congelation.cosim.coupling import Auto, refuse_tolerance
from congelation.cosim.result import Status
from congelation.errors import InvalidInput, counted
from congelation.fmi.description import describe
from congelation.results.identity import (
    ID_LENGTH,
    NUMERICS_VERSION,
    code_version,
    content_hash,
    file_hash,
    text_of,
)
from congelation.results.provenance import about
from congelation.results.record import Outcome, RunRecord
from congelation.results.store import Comparison, Store
from congelation.scenario.axes import Sweep
from congelation.scenario.metrics import metric
from congelation.scenario.parts import EXPERIMENT, Case, Scalar, Settings
from congelation.scenario.scenario import Scenario
from congelation.sweep.execute import ERROR, REFUSED, TIMED_OUT, WORKER_DIED, Job, Task

__all__ = ["FAILURES", "Plan", "plan_study", "varied_settings"]

_Run = tuple[str, Settings, int | None]
"""Variant, settings and replicate of a run."""

FAILURES = (
    *(status.name for status in Status if status not in (Status.COMPLETED, Status.TERMINATED)),
    REFUSED,
    ERROR,
    TIMED_OUT,
    WORKER_DIED,
)
"""How a run may end other than at its stop time."""


@dataclass(frozen=True)
class Plan(Comparison):
    """A study to carry out: what of it is missing, and what its runs have in common.

    Parameters
    ----------
    scenario : Scenario
        With every column recorded that its metrics need.
    store : Store
    job : Job
    """

    scenario: Scenario
    store: Store
    job: Job

    @cached_property
    def base(self) -> Mapping[str, Scalar | None]:
        """The settings that differ between runs, with the values that no variant changes: each
        record holds all of them, also those that its own run leaves."""
        case = self.scenario.case({})
        names = varied_settings(self.scenario, self.job.swept)
        return {name: _setting(case, name) for name in names}

    def tasks(self, numbers: Iterable[int] | None = None) -> Iterator[Task]:
        """The missing runs, or those with some numbers of the plan, in order."""
        runs, identity = _Runs(self.scenario, self.job.swept), _Identity(self.scenario)
        for number in self.missing if numbers is None else numbers:
            variant, settings, replicate = runs[number]
            run_id = identity.run_id(variant, settings)
            yield Task(run_id, number, variant, settings, replicate)

    def record(self, task: Task, outcome: Outcome) -> RunRecord:
        """The record of a run that ended."""
        none = dict.fromkeys(m.name for m in self.scenario.metrics)
        return RunRecord(
            run_id=task.run_id,
            study=self.job.study,
            number=task.number,
            variant=task.variant,
            replicate=task.replicate,
            settings={name: task.settings.get(name, value) for name, value in self.base.items()},
            fmus=self.job.fmus,
            seed=_sweep(self.scenario).seed if self.job.swept else None,
            code_version=code_version(),
            numerics_version=NUMERICS_VERSION,
            **{**vars(outcome), "metrics": {**none, **outcome.metrics}},
        )


def plan_study(
    scenario: Scenario,
    folder: Path,
    *,
    swept: bool,
    resume: bool = False,
    retry: Collection[str] = (),
    verify: bool = False,
    trust: bool | str = False,
    timeout: float | None = None,
    fmu_log: Path | None = None,
    write: bool = True,
) -> Plan:
    """Compare a study with what is finished of it.

    Parameters
    ----------
    scenario : Scenario
    folder : Path
        The result directory.
    swept : bool
        Whether variants are run at every point of the scenario's sweep.
    resume : bool
        Whether the directory may have runs; those of the study are not done again. Without a
        sweep, all of them are done again in any case.
    retry : collection of str
        Those of `FAILURES` that are done again nevertheless.
    verify : bool
        Whether runs are compared with the monolithic solution.
    trust : bool or str
        Whether they get error bars, as in `congelation.cosim.simulate`.
    timeout : float, optional
        Seconds that a run may take, in place of those of the sweep.
    fmu_log : Path, optional
        Takes what the FMUs log.
    write : bool
        False: the directory is not made, and nothing is written into it.

    Raises
    ------
    InvalidInput
        If the scenario has no sweep, does not stand at some point of it, or the directory has
        other runs and `resume` is false.
    """
    for status in retry:
        if status not in FAILURES:
            raise InvalidInput(f"'{status}' is no status to retry; valid: {', '.join(FAILURES)}")
    if timeout is not None and not 0.0 < timeout < math.inf:
        raise InvalidInput(f"timeout = {timeout} is not valid; give a positive number of seconds")
    if swept and scenario.sweep is None:
        raise InvalidInput(f"{scenario.place}: no [sweep]; give its axes, or use: congelation run")
    for key in scenario.given if swept else ():
        if f"{EXPERIMENT}.{key}" in _sweep(scenario).names():
            raise InvalidInput(
                f"{scenario.place}: {EXPERIMENT}.{key} is what an axis of the sweep sets; "
                "change it in the file"
            )
    # Before the directory is made or written to.
    store = Store(folder)
    _refuse_other_runs(store, scenario, swept, resume)
    scenario = _complete(scenario)
    identity = _Identity(scenario)
    if write:
        store.create()
    # What is finished. The runs are enumerated unless the store knows the plan.
    found = store.plan(
        identity.plan(swept),
        (
            (number, identity.run_id(variant, settings))
            for number, (variant, settings, _) in _Runs(scenario, swept).checked()
        ),
        retry if swept else None,
        trajectories=_sweep(scenario).trajectories,
    )
    if found.total == 0:
        raise InvalidInput(f"{scenario.place}: sweep.constraints leave no point")
    sweep = _sweep(scenario)
    axes = sweep.together() if swept else ()
    # The study: what its runs have in common, and how to read them. Other versions of packages
    # that only add to the provenance do not make it another study.
    described = {**about(scenario, varied_settings(scenario, swept), axes), "swept": swept}
    constant = {key: value for key, value in described.items() if key != "versions"}
    study = content_hash([identity.plan(swept), constant])
    job = Job(
        study=study,
        scenario=scenario.changed(sweep=None, text=""),
        folder=folder.absolute(),
        trajectories=sweep.trajectories if swept else True,
        verify=verify,
        timeout=timeout if timeout is not None or not swept else sweep.timeout,
        swept=swept,
        fmus={c.name: describe(c.fmu).sha256 for c in scenario.system.components},
        numerics=NUMERICS_VERSION,
        trust=trust,
        fmu_log=None if fmu_log is None else fmu_log.absolute(),
    )
    if write:
        store.begin(study, {**described, "planned": found.total})
    return Plan(**vars(found), scenario=scenario, store=store, job=job)


def _refuse_other_runs(store: Store, scenario: Scenario, swept: bool, resume: bool) -> None:
    """Raise InvalidInput where the directory has runs that the study may not be put beside."""
    done = store.count()
    if not done or (swept and resume):
        return
    if swept:
        raise InvalidInput(
            f"{store.root} holds {counted(done, 'finished run')}; give --resume to go on, "
            "or another --out"
        )
    newest = store.about()
    if newest.get("title") != scenario.title:
        raise InvalidInput(
            f"{store.root} holds runs of another scenario, '{newest.get('title')}'; "
            "give another --out"
        )
    if newest["swept"]:
        raise InvalidInput(f"{store.root} holds a sweep; give another --out")


def varied_settings(scenario: Scenario, swept: bool) -> tuple[str, ...]:
    """Names of the settings that a variant changes, of those that are swept, and of those given."""
    by_variant = (name for variant in scenario.variants for name in variant.settings)
    by_sweep = _sweep(scenario).names() if swept else ()
    # What options give is the same in all runs of a study; runs of others in the folder have not.
    by_options = (f"{EXPERIMENT}.{key}" for key in scenario.given)
    return tuple(dict.fromkeys((*by_variant, *by_sweep, *by_options)))


def _sweep(scenario: Scenario) -> Sweep:
    return scenario.sweep if scenario.sweep is not None else Sweep()


class _Runs:
    """The runs of a study by number: every variant at every repetition of every point it has.

    The numbers are those of the variant with most points; the others have no runs with numbers
    of points beyond their own, and no run has the number of a point that breaks a constraint.
    """

    def __init__(self, scenario: Scenario, swept: bool) -> None:
        self._scenario = scenario
        self._sweep = _sweep(scenario) if swept else Sweep()
        self._sweeps = [self._sweep.of_variant(variant.name) for variant in scenario.variants]
        self._repetitions = tuple(self._sweep.repetitions())

    def __getitem__(self, number: int) -> _Run:
        rest, variant = divmod(number, len(self._scenario.variants))
        place, repetition = divmod(rest, len(self._repetitions))
        return self._run(self._sweeps[variant].point(place), repetition, variant)

    def _run(self, point: Settings, repetition: int, variant: int) -> _Run:
        changed = self._scenario.variants[variant]
        replicate, seeds = self._repetitions[repetition]
        return changed.name, {**changed.settings, **point, **seeds}, replicate

    def checked(self) -> Iterator[tuple[int, _Run]]:
        """Number and run of each, the settings checked against the experiment."""
        check = _Check(self._scenario, self._sweep)
        variants = range(len(self._sweeps))
        each = len(self._repetitions) * len(variants)
        # Most variants have the same sweep, whose points are computed once.
        different = {id(sweep): sweep for sweep in self._sweeps}
        for place in range(max(sweep.size for sweep in self._sweeps)):
            points = {key: self._point(sweep, place) for key, sweep in different.items()}
            for number, (repetition, variant) in enumerate(
                itertools.product(range(len(self._repetitions)), variants), place * each
            ):
                point = points[id(self._sweeps[variant])]
                if point is not None:
                    run = self._run(point, repetition, variant)
                    check(run[1])
                    yield number, run

    def _point(self, sweep: Sweep, place: int) -> Settings | None:
        """A point of a sweep; None where there is none, or a constraint leaves it out."""
        if place >= sweep.size:
            return None
        point = sweep.point(place)
        try:
            return point if sweep.holds(point) else None
        except InvalidInput as error:
            place_of = f"{self._scenario.place}: sweep.constraints"
            raise InvalidInput(f"{place_of}: {error}") from error


class _Check:
    """Raises InvalidInput where the experiment does not stand with the settings of a run."""

    def __init__(self, scenario: Scenario, sweep: Sweep) -> None:
        self._scenario = scenario
        self._axes = [axis for axis in sweep.axes if axis.name.startswith(f"{EXPERIMENT}.")]
        # Few experiments differ; all runs of a plan with a million runs are checked in seconds.
        self._checked = lru_cache(maxsize=1024)(self._check)

    def __call__(self, settings: Settings) -> None:
        self._checked(tuple((k, v) for k, v in settings.items() if k.startswith(f"{EXPERIMENT}.")))

    def _check(self, settings: tuple[tuple[str, Scalar], ...]) -> None:
        scenario = self._scenario
        try:
            experiment = scenario.case(dict(settings)).experiment
            if experiment.tolerance is None:
                return
            # Only of a whole run: a variant may give the tolerance, and a point the coupling.
            try:
                if not isinstance(experiment.given_coupling, Auto):
                    refuse_tolerance(experiment.chosen_coupling, experiment.tolerance)
            except InvalidInput as error:
                raise InvalidInput(f"{scenario.place}: {EXPERIMENT}.tolerance: {error}") from error
        except InvalidInput as error:
            if not self._axes:
                raise
            drawn = " and ".join(f"{a.place} draws {a.name} ({a.distribution})" for a in self._axes)
            raise InvalidInput(f"{error}; {drawn}") from error


class _Identity:
    """The run_ids of a plan: hashes of a scenario's content and of the settings of each run.

    Title, figures, seed and number of a replicate are no part of what a run consists of.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._of_text = lru_cache(maxsize=1024)(_text_content)
        case = scenario.case({})
        content = {
            "numerics": NUMERICS_VERSION,
            "components": [
                [c.name, describe(c.fmu).sha256, self._content(c.start)]
                for c in case.system.components
            ],
            "connections": [str(connection) for connection in case.system.connections],
            "experiment": asdict(case.experiment),
            "metrics": [[m.name, m.metric, m.of, dict(m.options)] for m in scenario.metrics],
        }
        self._base = hashlib.sha256(text_of(content))

    def run_id(self, variant: str, settings: Settings) -> str:
        """The run_id of a run: equal where all that its numbers follow from is equal."""
        digest = self._base.copy()
        # Not as JSON, which takes three times as long: a plan may have a million runs.
        content = sorted((name, self._content(value)) for name, value in settings.items())
        digest.update(f"{variant!r} {content!r}".encode())
        return digest.hexdigest()[:ID_LENGTH]

    def plan(self, swept: bool) -> str:
        """Hash of all that the numbers and run_ids of a plan follow from."""
        sweep = _sweep(self._scenario)
        # The document of a grid has no sampling; the hashes of finished studies have it.
        table = {"sampling": sweep.sampling, **sweep.document()} if swept else {}
        content = {
            "base": self._base.hexdigest(),
            "variants": [[v.name, self._content(v.settings)] for v in self._scenario.variants],
            "sweep": {
                key: self._content(value)
                for key, value in table.items()
                if key not in ("trajectories", "timeout")
            },
            # Another version of these may draw another sample from the same seed.
            "drawn": [version("numpy"), version("scipy")] if swept and sweep.axes else [],
        }
        return content_hash(content)

    def _content(self, value: Any) -> Any:
        """A value as content; of a text that names a file, what is in the file."""
        if isinstance(value, str):
            return self._of_text(value)
        if isinstance(value, Mapping):
            return {key: self._content(entry) for key, entry in value.items()}
        if isinstance(value, list | tuple):
            return [self._content(entry) for entry in value]
        return value


def _text_content(value: str) -> str:
    # Unlike Path.is_file, this answers for a text that is too long for a name, too.
    return file_hash(Path(value)) if os.path.isfile(value) else value


def _setting(case: Case, name: str) -> Scalar | None:
    """The value of ``owner.key`` in a case; None for a start value left to the FMU."""
    owner, _, key = name.partition(".")
    if owner == EXPERIMENT:
        return cast(Scalar, getattr(case.experiment, key))
    component = next(c for c in case.system.components if c.name == owner)
    return cast(Scalar | None, component.start.get(key))  # a scenario's start values are flat


def _complete(scenario: Scenario) -> Scenario:
    """The scenario that also records the states of the loop, if a metric of it needs them."""
    loops = [spec for spec in scenario.metrics if metric(spec.metric).loop]
    if not loops:
        return scenario
    # Here, as it brings CasADi, which scenarios without such a metric do without.
    from congelation.verify.along_run import loop_states

    try:
        states = loop_states(scenario.case({}))
    except InvalidInput as error:
        raise InvalidInput(f"{scenario.place}: metrics.{loops[0].name}.metric: {error}") from error
    record = tuple(dict.fromkeys([*(scenario.experiment.record or ()), *states]))
    measured = scenario.measured
    return scenario.changed(
        experiment=replace(scenario.experiment, record=record),
        measured=None if measured is None else tuple(dict.fromkeys([*measured, *states])),
    )
