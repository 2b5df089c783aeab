"""What a scenario consists of, each a frozen record: experiment, metrics, figures, variants."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from congelation.cosim.coupling import make_coupling
from congelation.cosim.output import Output
from congelation.cosim.system import System
from congelation.errors import InvalidInput

__all__ = [
    "EXPERIMENT",
    "Case",
    "Experiment",
    "FigureSpec",
    "MetricSpec",
    "Scalar",
    "Settings",
    "Variant",
    "agreed",
]

Scalar = float | int | bool | str

Settings = Mapping[str, Scalar]
"""Values by ``component.variable`` and ``experiment.key``, one for each scalar variable."""

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
        Names ``component.variable``; a vector's name stands for its elements. Without any, every
        number among the outputs.
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
    record: tuple[str, ...] = ()
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


def agreed(experiment: Experiment, place: Callable[[str], str]) -> Experiment:
    """The experiment, after checking that its keys agree with each other.

    Parameters
    ----------
    experiment : Experiment
        Each key of which is valid by itself.
    place : callable
        Where a key stands, for messages.

    Raises
    ------
    InvalidInput
        Naming the key and what would be valid.
    """
    e = experiment
    if not 0.0 < e.stop_time - e.start_time < float("inf"):
        raise InvalidInput(
            f"{place('stop_time')} = {e.stop_time:g} is not valid; "
            f"give a time after start_time = {e.start_time:g}"
        )
    if e.step is None and e.tolerance is None:
        raise InvalidInput(f"{place('step')} is missing; give a time in seconds, or a tolerance")
    if e.output_every is not None and e.output_interval is not None:
        raise InvalidInput(f"{place('output_every')} and output_interval exclude each other")
    try:
        _check_coupling(e.coupling, tuple(e.options.items()))
    except InvalidInput as error:
        raise InvalidInput(f"{place('coupling')}: {error}") from error
    if "tolerance" in e.options and e.tolerance is not None:
        raise InvalidInput(
            f"{place('options')}.tolerance has no effect beside {EXPERIMENT}.tolerance; "
            "leave one of them out"
        )
    return experiment


@lru_cache(maxsize=256)
def _check_coupling(name: str, options: tuple[tuple[str, object], ...]) -> None:
    """Raise InvalidInput unless there is such a coupling; a sweep asks for the same few often."""
    make_coupling(name, dict(options))


@dataclass(frozen=True)
class MetricSpec:
    """A metric of a group of variables, under the name of its column.

    `of` is empty where the metric is of the closed loop as a whole.
    """

    name: str
    metric: str
    of: str = ""
    options: Mapping[str, float] = field(default_factory=dict)


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

    `settings` maps ``component.variable`` and ``experiment.key`` to values; those of a scenario
    have one entry for each scalar variable.
    """

    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Case:
    """A scenario with all settings applied: what one run does."""

    system: System
    experiment: Experiment
