"""What a scenario consists of, each a frozen record: experiment, metrics, figures, variants."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from congelation.arguments import check_fields
from congelation.cosim.experiment import Experiment, refuse_too_many_rows
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
    "replaced",
]

Scalar = float | int | bool | str

Settings = Mapping[str, Scalar]
"""Values by ``component.variable`` and ``experiment.key``, one for each scalar variable."""

EXPERIMENT = "experiment"
"""Name of the table, and what settings of its keys begin with."""


def replaced(table: Mapping[str, Any], given: Mapping[str, object]) -> dict[str, Any]:
    """A table of an experiment with keys replaced, and without what goes with the old values."""
    gone = set()
    if ("step" in given) != ("tolerance" in given):
        gone.add("tolerance" if "step" in given else "step")
    if "coupling" in given and given["coupling"] != table.get("coupling"):
        gone.add("options")
    return {key: value for key, value in table.items() if key not in gone} | dict(given)


def agreed(values: Mapping[str, Any], place: Callable[[str], str]) -> Experiment:
    """The experiment, after checking that its keys agree with each other.

    Parameters
    ----------
    values : mapping
        The fields of an experiment, each of which is valid by itself.
    place : callable
        Where a key stands, for messages.

    Raises
    ------
    InvalidInput
        Naming the key and what would be valid.
    """
    start, stop, tolerance = values["start_time"], values["stop_time"], values["tolerance"]
    if not 0.0 < stop - start < float("inf"):
        raise InvalidInput(
            f"{place('stop_time')} = {stop:g} is not valid; "
            f"give a time after start_time = {start:g}"
        )
    if values["step"] is None and tolerance is None:
        raise InvalidInput(f"{place('step')} is missing; give a time in seconds, or a tolerance")
    if values["output_every"] is not None and values["output_interval"] is not None:
        raise InvalidInput(f"{place('output_every')} and output_interval exclude each other")
    if values["output_interval"] is not None:
        refuse_too_many_rows(place("output_interval"), values["output_interval"], stop - start)
    try:
        experiment = Experiment(**values)
    except InvalidInput as error:
        raise InvalidInput(f"{place('coupling')}: {error}") from error
    if "tolerance" in experiment.options and tolerance is not None:
        raise InvalidInput(
            f"{place('options')}.tolerance has no effect beside {EXPERIMENT}.tolerance; "
            "leave one of them out"
        )
    return experiment


@dataclass(frozen=True)
class MetricSpec:
    """A number to compute of every run, under the name of its column.

    Parameters
    ----------
    name : str
    metric : str
        Which one: ``peak``, ``settling_time``, ``ise``, ..
    of : str
        The variable, or the vector whose norm is measured; empty where the metric is of the
        closed loop as a whole.
    options : mapping of str to float
        What the metric takes, such as ``below`` of ``settling_time``.

    Examples
    --------
    >>> cg.MetricSpec("settling", "settling_time", "plant.x", {"below": 1e-2}).of
    'plant.x'
    """

    name: str
    metric: str
    of: str = ""
    options: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class FigureSpec:
    """A figure: one panel per group of variables, ``|plant.x|`` for the norm of a group.

    `span` is the part of the time axis to show, in seconds; None: all of it. `scale` is that of the
    vertical axes: ``auto``, ``linear``, ``log`` or ``symlog``.
    """

    name: str
    panels: tuple[str, ...]
    span: tuple[float, float] | None = None
    scale: str = "auto"
    legend: bool = True

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def variables(self) -> tuple[str, ...]:
        """What the panels show."""
        return tuple(panel.strip("|") for panel in self.panels)


@dataclass(frozen=True)
class Variant:
    """A named change of the scenario.

    `settings` maps ``component.variable`` and ``experiment.key`` to values; those of a scenario
    have one entry for each scalar variable.

    Examples
    --------
    >>> cg.Variant("Controller 2", {"controller.damping": False}).name
    'Controller 2'
    """

    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class Case:
    """A scenario with all settings applied: what one run does."""

    system: System
    experiment: Experiment
