"""A scenario: one coupled system, its experiment, what to measure and draw, and its variants.

A `Scenario` is always complete and checked, against the model descriptions of its FMUs, whether
it was read from a file or composed in Python; both go through one reader, so a mistake gets the
same message, with its place in the file or in the call.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from congelation import keys
from congelation.arguments import check_fields
from congelation.cosim.system import System
from congelation.errors import InvalidInput, counted, shown
from congelation.scenario.axes import Sweep
from congelation.scenario.parts import (
    EXPERIMENT,
    Case,
    Experiment,
    FigureSpec,
    MetricSpec,
    Scalar,
    Variant,
    agreed,
)
from congelation.scenario.read_tables import read_scenario
from congelation.toml import Section

__all__ = [
    "EXPERIMENT",
    "Case",
    "Experiment",
    "FigureSpec",
    "MetricSpec",
    "Scenario",
    "Variant",
]


@dataclass(frozen=True, repr=False)
class Scenario:
    """A checked scenario.

    Parameters
    ----------
    title : str
    system : System
        Components with start values, before a variant changes any. They may be given as arrays;
        the scenario has one entry for each scalar variable.
    experiment : Experiment
        Before a variant changes it; its `record` gets all that metrics and figures need as well.
    variants : tuple of Variant
        A scenario without any gets one, without settings.
    metrics, figures : tuple
    sweep : Sweep, optional
        The points at which each variant is run by a sweep.
    file : Path, optional
        Where it was read from.
    text : str
        What was read, kept for the record.
    open : tuple of str
        Inputs ``component.variable`` that are meant to be left without a connection.
    measured : tuple of str or None
        Those of the recorded columns that metrics are of; None where they are of all. It follows
        from the other fields.
    warnings : tuple of str
        What may be a mistake: forgotten connections, units that cannot be compared.
    given : tuple of str
        Keys of its experiment whose values options of a command gave in place of the file.

    Raises
    ------
    InvalidInput
        A name that does not exist, a value that does not fit; naming its place.

    Examples
    --------
    >>> scenario = cg.Scenario(
    ...     title="Scalar loop",
    ...     system=cg.System(
    ...         (cg.Component("plant", "fmus/ScalarPlant.fmu", {"x0": [1.0]}),
    ...          cg.Component("controller", "fmus/ScalarController.fmu")),
    ...         (cg.Connection("plant.x", "controller.x"),
    ...          cg.Connection("controller.u", "plant.u")),
    ...     ),
    ...     experiment=cg.Experiment(stop_time=2.0, coupling="hermite", tolerance=1e-6),
    ...     variants=(cg.Variant("Controller 1", {"controller.damping": True}),),
    ... )
    >>> scenario.experiment.record[:2]
    ('plant.x', 'plant.theta[1]')
    """

    title: str
    system: System
    experiment: Experiment
    variants: tuple[Variant, ...] = ()
    metrics: tuple[MetricSpec, ...] = ()
    figures: tuple[FigureSpec, ...] = ()
    sweep: Sweep | None = None
    file: Path | None = None
    text: str = ""
    open: tuple[str, ...] = ()
    measured: tuple[str, ...] | None = field(default=None, init=False)
    warnings: tuple[str, ...] = field(default=(), init=False)
    given: tuple[str, ...] = field(default=(), init=False)

    def __post_init__(self) -> None:
        check_fields(self)
        names = [metric.name for metric in self.metrics]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise InvalidInput(f"Scenario: metric '{twice}' is given twice; names must differ")
        lists = len(self.sweep.lists) if self.sweep is not None else 0
        spelled = partial(_python_place, lists=lists)
        self._fill(read_scenario(Section("Scenario", "", self.document(), spelled=spelled), "run"))

    def __repr__(self) -> str:
        """What is run, without the start values of its FMUs."""
        fmus = ", ".join(f"{c.name} ({c.fmu.name})" for c in self.system.components)
        experiment = self.experiment
        steps = [
            f"{name} {value:g}"
            for name, value in (("step", experiment.step), ("tolerance", experiment.tolerance))
            if value is not None
        ]
        lines = [
            f"Scenario: {self.title}",
            f"  components: {fmus}; {counted(len(self.system.connections), 'connection')}",
            f"  {experiment.start_time:g} .. {experiment.stop_time:g} s, "
            + ", ".join([f"coupling {experiment.coupling}", *steps]),
            "  variants: " + ", ".join(variant.name for variant in self.variants),
        ]
        if self.metrics:
            lines.append("  metrics: " + ", ".join(metric.name for metric in self.metrics))
        if self.sweep is not None:
            axes = len(self.sweep.lists) + len(self.sweep.axes)
            lines.append(
                f"  sweep: {counted(axes, 'axis', 'axes')}, {counted(self.sweep.samples, 'sample')}"
            )
        return "\n".join(lines)

    @classmethod
    def from_document(cls, document: Section, file: Path, text: str) -> Scenario:
        """The scenario that the tables of a file describe; `text` is what was read.

        Raises
        ------
        InvalidInput
            Naming the file, the path of the key, and what would be valid.
        """
        scenario = object.__new__(cls)
        scenario._fill({**read_scenario(document, file.stem), "file": file, "text": text})
        return scenario

    def changed(self, **values: Any) -> Scenario:
        """This scenario with other values of fields, which are known to be valid."""
        scenario = copy.copy(self)
        scenario._fill(values)
        return scenario

    def _fill(self, values: Mapping[str, object]) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def place(self) -> str:
        """What messages about it begin with, which is the file if it was read from one."""
        return "Scenario" if self.file is None else str(self.file)

    def case(self, settings: Mapping[str, Scalar]) -> Case:
        """This scenario with settings applied, which are those of variants and points of a sweep:
        one for each scalar variable, as `variants` of a scenario has them.

        Raises
        ------
        InvalidInput
            If the keys of the experiment do not agree with each other.
        """
        # Settings have been checked one by one when the scenario was; here, as a sweep comes by
        # for every point, only what they say together is.
        changes: dict[str, dict[str, Any]] = {}
        for name, value in settings.items():
            owner, _, key = name.partition(".")
            changes.setdefault(owner, {})[key] = value
        experiment = self.experiment
        if EXPERIMENT in changes:
            # A normal distribution draws any number.
            for name, value in changes[EXPERIMENT].items():
                admitted = keys.EXPERIMENT[name]
                if isinstance(value, float) and not admitted.admits(value):
                    raise InvalidInput(
                        f"{self.place}: {EXPERIMENT}.{name} = {shown(value)} is not valid; "
                        f"give {admitted.valid}"
                    )
            values = {f.name: getattr(experiment, f.name) for f in fields(experiment)}
            values |= changes[EXPERIMENT]
            experiment = agreed(values, lambda key: f"{self.place}: {EXPERIMENT}.{key}")
        components = tuple(
            replace(c, start={**c.start, **changes[c.name]}) if c.name in changes else c
            for c in self.system.components
        )
        return Case(replace(self.system, components=components), experiment)

    def document(self) -> dict[str, Any]:
        """The tables of a scenario file that says the same."""
        experiment = {
            name: _plain(getattr(self.experiment, name)) for name in keys.EXPERIMENT.names
        }
        document = {
            "title": self.title,
            "connections": [str(connection) for connection in self.system.connections],
            "components": {
                c.name: {"fmu": str(Path(c.fmu).absolute()), "start": _plain(c.start)}
                for c in self.system.components
            },
            EXPERIMENT: {key: value for key, value in experiment.items() if value is not None},
            "metrics": {
                m.name: {"metric": m.metric, **({"of": m.of} if m.of else {}), **_plain(m.options)}
                for m in self.metrics
            },
            "figures": [
                {
                    "name": f.name,
                    "panels": _plain(f.panels),
                    **({} if f.span is None else {"span": _plain(f.span)}),
                    "scale": f.scale,
                    "legend": f.legend,
                }
                for f in self.figures
            ],
            "variants": [{"name": v.name, "set": _plain(v.settings)} for v in self.variants],
            "open": list(self.open),
        }
        if self.sweep is not None:
            document["sweep"] = _plain(self.sweep.document())
        return document


def _plain(value: Any) -> Any:
    """A value as TOML would give it: without numpy's numbers and arrays, tuples, paths."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return str(value) if isinstance(value, Path) else value


def _python_place(path: str, lists: int) -> str:
    """Where something stands in the call of `Scenario`, from its path in a file."""

    def index(match: re.Match[str]) -> str:
        number = int(match[2]) - 1
        if match[1] == "sweep.axes" and number < lists:
            return f"sweep.lists[{number}]"
        return f"{match[1]}[{number - lists if match[1] == 'sweep.axes' else number}]"

    path = re.sub(r"^(variants|figures|sweep\.axes)\[(\d+)\]", index, path)
    path = re.sub(r"^components\.([^.]+)", r"Component('\1')", path)
    path = re.sub(r"^metrics\.([^.]+)", r"MetricSpec('\1')", path)
    path = re.sub(r"^(variants\[\d+\])\.set$", r"\1.settings", path)
    return re.sub(r"^(variants\[\d+\])\.set\.(.+)$", r"\1.settings['\2']", path)
