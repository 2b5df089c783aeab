"""A scenario: one coupled system, its experiment, what to measure and draw, and its variants."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from congelation.cosim.coupling import Coupling, make_coupling
from congelation.cosim.output import Output
from congelation.cosim.system import System
from congelation.scenario.axes import Sweep
from congelation.scenario.start_values import Scalar
from congelation.toml import Section

__all__ = [
    "Case",
    "Experiment",
    "FigureSpec",
    "MetricSpec",
    "Scenario",
    "Variant",
]

EXPERIMENT = "experiment"
"""Name of the table, and what settings of its keys begin with."""


@dataclass(frozen=True)
class Experiment:
    """What to do with a system.

    Parameters
    ----------
    stop_time : float
        Seconds.
    record : tuple of str
        Names ``component.variable``; a vector's name stands for its elements.
    start_time : float
        Seconds.
    step : float, optional
        Distance of the communication points, in seconds; with a tolerance, the first one tried.
    tolerance : float, optional
        Chooses the steps: how far inputs may be from the outputs that drive them.
    coupling : str
        How inputs move between communication points, one of `congelation.cosim.coupling`.
    options : mapping
        Options of the coupling.
    slave_tolerance : float, optional
        Relative tolerance of the integration inside the FMUs.
    output_interval : float, optional
        Seconds between recorded rows, whatever the steps; else every communication point is one.
    output_every : int, optional
        Every how many communication points a row is recorded; not with an interval.
    """

    stop_time: float
    record: tuple[str, ...]
    start_time: float = 0.0
    step: float | None = None
    tolerance: float | None = None
    coupling: str = "derivative"
    options: Mapping[str, object] = field(default_factory=dict)
    slave_tolerance: float | None = None
    output_interval: float | None = None
    output_every: int | None = None

    @property
    def output(self) -> Output | None:
        """What to record, where it is not every communication point."""
        if self.output_interval is not None:
            return Output(interval=self.output_interval)
        return None if self.output_every is None else Output(every=self.output_every)


@dataclass(frozen=True)
class MetricSpec:
    """A metric of a group of variables, under the name of its column.

    `of` is empty where the metric is of the closed loop as a whole.
    """

    name: str
    metric: str
    of: str
    options: Mapping[str, float]


@dataclass(frozen=True)
class FigureSpec:
    """A figure: one panel per group of variables, ``|plant.x|`` for the norm of a group.

    `span` is the part of the time axis to show, in seconds; None: all of it.
    """

    name: str
    panels: tuple[str, ...]
    span: tuple[float, float] | None = None

    @property
    def variables(self) -> tuple[str, ...]:
        """What the panels show."""
        return tuple(panel.strip("|") for panel in self.panels)


@dataclass(frozen=True)
class Variant:
    """A named change of the scenario.

    `settings` maps ``component.variable`` and ``experiment.key`` to values.
    """

    name: str
    settings: Mapping[str, Scalar]


@dataclass(frozen=True)
class Case:
    """A scenario with all settings applied: what one run does."""

    system: System
    experiment: Experiment


@dataclass(frozen=True)
class Scenario:
    """A scenario as its file states it.

    Parameters
    ----------
    title : str
    file : Path
    text : str
        The file's text, kept for the record.
    system : System
        Components with flat start values, before a variant changes any.
    experiment : mapping
        The keys of the experiment table, before a variant changes any; `record` holds all that
        metrics and figures need as well.
    metrics, figures, variants : tuple
        A scenario without variants has one, named after the file.
    sweep : Sweep, optional
        The points at which each variant is run by a sweep.
    measured : tuple of str, optional
        Those of the recorded columns that metrics are of; None where they are of all.
    """

    title: str
    file: Path
    text: str
    system: System
    experiment: Mapping[str, object]
    metrics: tuple[MetricSpec, ...] = ()
    figures: tuple[FigureSpec, ...] = ()
    variants: tuple[Variant, ...] = ()
    sweep: Sweep | None = None
    measured: tuple[str, ...] | None = None

    def case(self, settings: Mapping[str, Scalar]) -> Case:
        """This scenario with `settings` applied.

        Raises
        ------
        InvalidInput
            If the experiment does not stand with these settings.
        """
        changes: dict[str, dict[str, Scalar]] = {EXPERIMENT: {}}
        for name, value in settings.items():
            owner, _, key = name.partition(".")
            changes.setdefault(owner, {})[key] = value
        components = tuple(
            replace(c, start={**c.start, **changes.get(c.name, {})}) for c in self.system.components
        )
        changed = Section(str(self.file), EXPERIMENT, changes[EXPERIMENT])
        return Case(replace(self.system, components=components), self._experiment(changed))

    def experiment_values(self, changed: Section) -> dict[str, Scalar]:
        """The experiment's settings in a table, as plain numbers and names.

        Raises
        ------
        InvalidInput
            If the experiment does not stand with them.
        """
        changed.only(f.name for f in fields(Experiment) if f.name not in ("record", "options"))
        experiment = self._experiment(changed)
        return {key: getattr(experiment, key) for key in changed.data}

    def _experiment(self, changed: Section) -> Experiment:
        """The experiment with some keys changed, which stand elsewhere in the file."""
        elsewhere = {key: changed.at(key) for key in changed.data}
        merged = {**self.experiment, **changed.data}
        return read_experiment(Section(str(self.file), EXPERIMENT, merged, elsewhere))


def read_experiment(section: Section) -> Experiment:
    """The experiment that a table describes.

    Raises
    ------
    InvalidInput
        Naming the key and what would be valid.
    """
    section.only(f.name for f in fields(Experiment))
    start = section.seconds("start_time") if "start_time" in section.data else 0.0
    stop = section.seconds("stop_time")
    if not (stop > start and math.isfinite(stop - start)):
        raise section.wrong("stop_time", f"a time after start_time = {start:g}")
    step = section.duration("step") if "step" in section.data else None
    if step is None and "tolerance" not in section.data:
        raise section.error("step", "is missing; give a time in seconds, or a tolerance")
    coupling = section.text("coupling", "derivative")
    options = _options(section)
    chosen = section.attempt("coupling", partial(make_coupling, coupling, options))
    _check_options(section, chosen)
    return Experiment(
        stop_time=stop,
        record=section.texts("record"),
        start_time=start,
        step=step,
        tolerance=_optional_tolerance(section, "tolerance"),
        coupling=coupling,
        options=options,
        slave_tolerance=_optional_tolerance(section, "slave_tolerance"),
        **_output(section),
    )


def _options(section: Section) -> dict[str, object]:
    """The options of the coupling; those with a unit in seconds."""
    table = section.section("options")
    return {
        key: table.seconds(key) if isinstance(value, Mapping) else value
        for key, value in table.data.items()
    }


def _check_options(section: Section, coupling: Coupling) -> None:
    """Raise InvalidInput where an option has a unit and is no time, or has no effect."""
    table = section.section("options")
    for key, value in table.data.items():
        if isinstance(value, Mapping) and key not in coupling.periods:
            raise table.error(key, "is no time; give it without a unit")
    if "tolerance" in table.data and "tolerance" in section.data:
        own = section.at("tolerance")
        raise table.error("tolerance", f"has no effect beside {own}; leave one of them out")


def _output(section: Section) -> dict[str, Any]:
    """Which rows are recorded, if the table says so."""
    keys = [key for key in ("output_interval", "output_every") if key in section.data]
    if len(keys) > 1:
        raise section.error("output_every", "and output_interval exclude each other")
    if keys == ["output_interval"]:
        return {"output_interval": section.duration("output_interval")}
    if keys == ["output_every"]:
        every = section.integer("output_every", 0)
        if every < 1:
            raise section.wrong("output_every", "a whole number of at least 1")
        return {"output_every": every}
    return {}


def _optional_tolerance(section: Section, key: str) -> float | None:
    """The relative tolerance under `key`, if there is one."""
    if key not in section.data:
        return None
    valid = "a number between 0 and 1"
    tolerance = section.number(key, valid)
    if not 0.0 < tolerance < 1.0:
        raise section.wrong(key, valid)
    return tolerance
