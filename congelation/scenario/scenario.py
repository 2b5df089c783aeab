"""A scenario: one coupled system, its experiment, what to measure and draw, and its variants.

A `Scenario` is always complete and checked, against the model descriptions of its FMUs, whether
it was read from a file or composed in Python; both go through one reader, so a mistake gets the
same message, with its place in the file or in the call.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from congelation import keys
from congelation.cosim.system import Component, Connection, Recorded, ResolvedSystem, System
from congelation.errors import InvalidInput, nearest
from congelation.fmi.description import describe
from congelation.scenario.axes import Sweep
from congelation.scenario.metrics import metric
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
from congelation.scenario.settings import SettingsReader, component_values
from congelation.scenario.sweep_table import read_sweep
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

_BUILD = "build it with: congelation build SPEC.toml"


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

    def __post_init__(self) -> None:
        lists = len(self.sweep.lists) if self.sweep is not None else 0
        spelled = partial(_python_place, lists=lists)
        self._fill(_read(Section("Scenario", "", self.document(), spelled=spelled), "run"))

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
            f"  components: {fmus}; {len(self.system.connections)} connections",
            f"  {experiment.start_time:g} .. {experiment.stop_time:g} s, "
            + ", ".join([f"coupling {experiment.coupling}", *steps]),
            "  variants: " + ", ".join(variant.name for variant in self.variants),
        ]
        if self.metrics:
            lines.append("  metrics: " + ", ".join(metric.name for metric in self.metrics))
        if self.sweep is not None:
            axes = len(self.sweep.lists) + len(self.sweep.axes)
            lines.append(f"  sweep: {axes} axes, {self.sweep.samples} samples")
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
        scenario._fill({**_read(document, file.stem), "file": file, "text": text})
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
        """What messages about it begin with: the file, if it was read from one."""
        return "Scenario" if self.file is None else str(self.file)

    def case(self, settings: Mapping[str, Scalar]) -> Case:
        """This scenario with settings applied, which are those of variants and points of a sweep.

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
                        f"{self.place}: {EXPERIMENT}.{name} = {value!r} is not valid; "
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


def _read(document: Section, stem: str) -> dict[str, Any]:
    """The fields of the scenario that a document describes.

    `stem` names the variant of a scenario that has none.
    """
    top = document.read(keys.SCENARIO)
    components = tuple(_component(s, name) for name, s in top["components"].subsections())
    connections = tuple(
        document.attempt("connections", partial(Connection.parse, connection))
        for connection in top["connections"]
    )
    system = System(components, connections)
    try:
        resolved = system.resolve()
    except InvalidInput as error:
        raise InvalidInput(f"{document.file}: {error}") from error
    experiment = _experiment(top[EXPERIMENT])
    metrics = tuple(_metric(s, name) for name, s in top["metrics"].subsections())
    figures = tuple(_figure(s) for s in top["figures"])
    experiment, measured = _recording(top, resolved, experiment, metrics, figures)
    reader = SettingsReader(
        {member.name: member.description for member in resolved.members},
        _driven(resolved),
        experiment,
    )
    for component in components:
        start = top["components"].section(component.name).section("start")
        reader.check_free(start, component.name, component.start)
    variants = _variants(top["variants"], reader) or (Variant(stem),)
    _check_figures(top["figures"], figures, experiment, variants)
    sweep = read_sweep(top["sweep"], reader) if "sweep" in document.data else None
    given = {f"{c.name}.{name}" for c in components for name in c.start}
    given |= {name for variant in variants for name in variant.settings}
    given |= set(sweep.names()) if sweep is not None else set()
    left_open = document.attempt("open", partial(_open, resolved, top["open"]))
    return {
        "title": top["title"],
        "system": system,
        "experiment": experiment,
        "variants": variants,
        "metrics": metrics,
        "figures": figures,
        "sweep": sweep,
        "open": top["open"],
        "measured": measured,
        "warnings": (
            *_doubtful(resolved, document.file),
            *_forgotten(resolved, {*given, *left_open, *reader.driven}, document.file),
        ),
    }


def _component(section: Section, name: str) -> Component:
    read = section.read(keys.COMPONENT)
    if name == EXPERIMENT:
        raise section.within(f"choose a name other than '{name}'")
    fmu = _find_fmu(section)
    description = section.attempt("fmu", partial(describe, fmu))
    return Component(name, fmu, component_values(read["start"], read["profile"], description))


def _find_fmu(section: Section) -> Path:
    """The file that `fmu` names: a path from the scenario's folder, or a name in a fmus/ folder."""
    name = section.text("fmu")
    home = Path(section.file).absolute().parent
    if name.endswith(".fmu"):
        return home / name
    folders = [folder / "fmus" for folder in (home, *home.parents, Path.cwd())]
    for folder in folders:
        if (folder / f"{name}.fmu").is_file():
            return folder / f"{name}.fmu"
    built = sorted({f.stem for folder in folders for f in folder.glob("*.fmu")})
    remedy = f"{nearest(name, built)} Or {_BUILD}" if built else _BUILD
    raise section.error("fmu", f"= '{name}' is no FMU in fmus/; {remedy}")


def _experiment(section: Section) -> Experiment:
    """The experiment that a table describes."""
    values = section.read(keys.EXPERIMENT)
    options: Section = values["options"]
    values["options"] = {
        key: options.seconds(key) if isinstance(value, Mapping) else value
        for key, value in options.data.items()
    }
    for key, value in options.data.items():
        if isinstance(value, list):
            raise options.wrong(key, "one value")
    experiment = agreed(values, section.place)
    periods = experiment.chosen_coupling.periods
    for key, value in options.data.items():
        if isinstance(value, Mapping) and key not in periods:
            raise options.error(key, "is no time; give it without a unit")
    return experiment


def _metric(section: Section, name: str) -> MetricSpec:
    if "." in name or not name.strip():
        raise section.within(f"choose a name other than '{name}'")
    read = section.read(keys.METRIC)
    found = section.attempt("metric", partial(metric, read["metric"]))
    of = () if found.loop else ("of",)
    section.require(*of).only(("metric", *of, *found.options))
    section.require(*(option for option, required in found.options.items() if required))
    options = {key: section.number(key) for key in section.data if key in found.options}
    for key in found.positive:
        if options.get(key, 1.0) <= 0.0:
            raise section.wrong(key, "a positive number")
    return MetricSpec(name, found.name, section.text("of") if of else "", options)


def _figure(section: Section) -> FigureSpec:
    read = section.read(keys.FIGURE)
    name, panels, span = read["name"], read["panels"], read["span"]
    if not name.replace("_", "").replace("-", "").isalnum():
        raise section.wrong("name", "letters, digits, - and _, as it names a file")
    if not panels:
        raise section.wrong("panels", "at least one variable")
    if span and (len(span) != 2 or span[0] >= span[1]):
        raise section.wrong("span", "[start, stop] in seconds")
    return FigureSpec(name, panels, (span[0], span[1]) if span else None)


def _check_figures(
    sections: Iterable[Section],
    figures: Iterable[FigureSpec],
    experiment: Experiment,
    variants: Iterable[Variant],
) -> None:
    """Raise InvalidInput for a figure that would replace another, or shows no part of any run."""
    runs = [v.settings for v in variants]
    start = min(run.get(f"{EXPERIMENT}.start_time", experiment.start_time) for run in runs)
    stop = max(run.get(f"{EXPERIMENT}.stop_time", experiment.stop_time) for run in runs)
    names: set[str] = set()
    for figure, section in zip(figures, sections, strict=True):
        if figure.name in names:
            raise section.error("name", f"= '{figure.name}' is given twice; names must differ")
        names.add(figure.name)
        if figure.span is not None and not (figure.span[0] < stop and figure.span[1] > start):
            raise section.wrong("span", f"a part of the time from {start:g} to {stop:g}")


def _variants(sections: Iterable[Section], reader: SettingsReader) -> tuple[Variant, ...]:
    variants: list[Variant] = []
    for section in sections:
        read = section.read(keys.VARIANT)
        name = read["name"]
        if any(name == other.name for other in variants):
            raise section.error("name", f"= '{name}' is given twice; names must differ")
        variants.append(Variant(name, reader.read(read["set"])))
    return tuple(variants)


def _driven(resolved: ResolvedSystem) -> dict[str, str]:
    """The inputs that connections drive, ``component.variable``, and what each is driven by."""
    found: dict[str, str] = {}
    for link in (*resolved.links, *resolved.discrete_links):
        for variable in (link.input, *link.target_derivatives):
            if variable is not None:
                found[f"{resolved.members[link.target].name}.{variable.name}"] = link.name
    return found


def _open(resolved: ResolvedSystem, names: Iterable[str]) -> set[str]:
    """The scalar inputs that names stand for."""
    found: set[str] = set()
    for name in names:
        for entry in resolved.recorded([name]):
            if entry.variable.causality != "input":
                raise InvalidInput(f"'{name}' is of causality {entry.variable.causality}, no input")
            found.add(entry.name)
    return found


def _doubtful(resolved: ResolvedSystem, place: str) -> Iterator[str]:
    """A line for each connection whose units cannot be compared."""
    for link in resolved.links:
        if link.doubt:
            yield f"{place}: connection '{link.name}': {link.doubt}"


def _forgotten(resolved: ResolvedSystem, known: Collection[str], place: str) -> Iterator[str]:
    """A line for each input that nothing drives or sets, and that is not meant to be left alone."""
    for member in resolved.members:
        description = member.description
        for name, variable in description.variables.items():
            if (
                variable.causality == "input"
                and f"{member.name}.{name}" not in known
                and name not in description.open_inputs
            ):
                yield (
                    f"{place}: input '{member.name}.{name}' has no connection and no start value; "
                    f'connect it, set it, or list it in open = ["{member.name}.{name}"]'
                )


def _recording(
    top: Mapping[str, Any],
    resolved: ResolvedSystem,
    experiment: Experiment,
    metrics: Iterable[MetricSpec],
    figures: Iterable[FigureSpec],
) -> tuple[Experiment, tuple[str, ...] | None]:
    """The experiment with all columns that are named, measured and drawn; and those measured.

    An experiment that names none records every number among the outputs.
    """

    def names(recorded: Iterable[Recorded]) -> list[str]:
        return [column.name for column in recorded]

    section = top[EXPERIMENT]
    wanted = experiment.record or None
    columns = names(section.attempt("record", partial(resolved.recorded, wanted)))
    measured: list[str] = []
    for spec in metrics:
        found, place = metric(spec.metric), top["metrics"].section(spec.name)
        if not found.loop:  # the states of a loop are added where a study is planned
            group = names(place.attempt("of", partial(resolved.recorded, [spec.of])))
            place.attempt("of", partial(found.check_size, len(group)))
            columns += group
            measured += group
    for figure, place in zip(figures, top["figures"], strict=True):
        columns += names(place.attempt("panels", partial(resolved.recorded, figure.variables)))
    everything = any(metric(spec.metric).recorded for spec in metrics)
    return (
        replace(experiment, record=tuple(dict.fromkeys(columns))),
        None if everything else tuple(dict.fromkeys(measured)),
    )
