"""The tables of a scenario file, or of a scenario composed in Python: read, and checked."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from congelation import keys
from congelation.cosim.system import Component, Connection, Recorded, ResolvedSystem, System
from congelation.errors import InvalidInput, nearest
from congelation.fmi.description import EVENT, describe
from congelation.scenario.metrics import metric
from congelation.scenario.parts import (
    EXPERIMENT,
    Experiment,
    FigureSpec,
    MetricSpec,
    Variant,
    agreed,
)
from congelation.scenario.read_sweep import read_sweep
from congelation.scenario.settings import SettingsReader, component_values
from congelation.toml import Section

__all__ = ["read_scenario"]

_BUILD = "build it with: congelation build SPEC.toml"


def read_scenario(document: Section, stem: str) -> dict[str, Any]:
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
        {component.name: component.start for component in components},
        _driven(resolved),
        experiment,
    )
    for component in components:
        start = top["components"].section(component.name).section("start")
        reader.check_free(start, component.name, component.start)
    variants = _variants(top["variants"], reader) or (Variant(stem),)
    _check_figures(top["figures"], figures, experiment, variants)
    sweep = None
    if "sweep" in document.data:
        sweep = read_sweep(top["sweep"], reader, {v.name: v.settings for v in variants})
    given = {f"{c.name}.{name}" for c in components for name in c.start}
    given |= {name for variant in variants for name in variant.settings}
    given |= set(sweep.names()) if sweep is not None else set()
    left_open = document.attempt("open", partial(_open, resolved, reader.driven, top["open"]))
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
            *_out_of_range(resolved, variants, document.file),
            *_mixed(resolved, metrics, document.file),
            *_past_the_end(metrics, experiment, given, document.file),
            *_forgotten(resolved, {*given, *left_open, *reader.driven}, document.file),
        ),
    }


def _past_the_end(
    metrics: Sequence[MetricSpec], experiment: Experiment, given: Collection[str], file: str
) -> Iterator[str]:
    """A line for a step that is longer than every run, and for each metric of later times."""
    if f"{EXPERIMENT}.stop_time" in given:
        return
    horizon, step = experiment.stop_time - experiment.start_time, experiment.step
    fixed = experiment.tolerance is None and f"{EXPERIMENT}.step" not in given
    if fixed and step is not None and step > horizon:
        yield (
            f"{file}: {EXPERIMENT}.step = {step:g} is longer than the run, {horizon:g} s, which is "
            "one step"
        )
    for found in metrics:
        after = found.options.get("after", -math.inf)
        if -math.inf < after < experiment.start_time:
            yield (
                f"{file}: metrics.{found.name}.after = {after:g} is before start_time = "
                f"{experiment.start_time:g}: it has no effect"
            )
        if after > experiment.stop_time:
            yield (
                f"{file}: metrics.{found.name}.after = {after:g} is past stop_time = "
                f"{experiment.stop_time:g}: the metric has no value"
            )


def _mixed(resolved: ResolvedSystem, metrics: Iterable[MetricSpec], file: str) -> Iterator[str]:
    """A line for each metric that takes the norm of elements in different units."""
    for found in metrics:
        units = {c.variable.unit for c in resolved.recorded([found.of])} if found.of else ()
        if len(units) > 1:
            names = ", ".join(f"'{unit}'" for unit in sorted(units))
            yield (
                f"{file}: metrics.{found.name}: '{found.of}' has elements in {names}, whose norm "
                "depends on the units; give a metric of each element"
            )


def _component(section: Section, name: str) -> Component:
    read = section.read(keys.COMPONENT)
    if name == EXPERIMENT:
        raise section.within(f"choose a name other than '{name}'")
    fmu = _find_fmu(section, read["native"])
    description = section.attempt("fmu", partial(describe, fmu))
    return Component(name, fmu, component_values(read["start"], read["profile"], description))


def _find_fmu(section: Section, native: bool) -> Path:
    """The file that `fmu` names: a path from the scenario's folder, or a name in a fmus/ folder,
    or in the folder native of that."""
    name: str = section.as_kind("fmu", "text")
    home = Path(section.file).absolute().parent
    if name.endswith(".fmu"):
        if native:
            raise section.error(
                "native",
                f"= true goes with a name, and fmu = '{name}' is a path; leave native out, or give "
                f'fmu = "{Path(name).stem}"',
            )
        return home / name
    where = "fmus/native" if native else "fmus"
    folders = [folder / where for folder in (home, *home.parents, Path.cwd())]
    for folder in folders:
        if (folder / f"{name}.fmu").is_file():
            return folder / f"{name}.fmu"
    built = sorted({f.stem for folder in folders for f in folder.glob("*.fmu")})
    build = f"{_BUILD} --native" if native else _BUILD
    remedy = f"{nearest(name, built)} Or {build}" if built else build
    raise section.error("fmu", f"= '{name}' is no FMU in {where}/; {remedy}")


def _experiment(section: Section) -> Experiment:
    """The experiment that a table describes."""
    values = section.read(keys.EXPERIMENT)
    options: Section = values["options"]
    values["options"] = {
        key: options.as_kind(key, "time") if isinstance(value, Mapping) else value
        for key, value in options.data.items()
    }
    for key, value in options.data.items():
        if isinstance(value, list):
            raise options.wrong(key, "one value")
    experiment = agreed(values, section.place)
    periods = experiment.periods
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
    options = {key: section.as_kind(key, "number") for key in section.data if key in found.options}
    for key in found.positive:
        if options.get(key, 1.0) <= 0.0:
            raise section.wrong(key, "a positive number")
    return MetricSpec(name, found.name, section.as_kind("of", "text") if of else "", options)


def _figure(section: Section) -> FigureSpec:
    read = section.read(keys.FIGURE)
    name, panels, span = read["name"], read["panels"], read["span"]
    if not name.replace("_", "").replace("-", "").isalnum():
        raise section.wrong("name", "letters, digits, - and _, as it names a file")
    if not panels:
        raise section.wrong("panels", "at least one variable")
    if span and (len(span) != 2 or span[0] >= span[1]):
        raise section.wrong("span", "[start, stop] in seconds")
    shown = (span[0], span[1]) if span else None
    return FigureSpec(name, panels, shown, read["scale"], read["legend"])


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


def _open(resolved: ResolvedSystem, driven: Mapping[str, str], names: Iterable[str]) -> set[str]:
    """The scalar inputs that names stand for."""
    found: set[str] = set()
    for name in names:
        for entry in resolved.columns([name], "input"):
            if entry.variable.causality != "input":
                raise InvalidInput(f"'{name}' is of causality {entry.variable.causality}, no input")
            if link := driven.get(entry.name):
                raise InvalidInput(f"'{entry.name}' is driven by '{link}'; leave one of them out")
            found.add(entry.name)
    return found


def _doubtful(resolved: ResolvedSystem, place: str) -> Iterator[str]:
    """A line for each connection whose units or enumerations cannot be compared, and for each
    announcement of jumps that is no time in seconds."""
    for member in resolved.members:
        named = member.description.variables.get(EVENT)
        if named is not None and named.unit and member.description.announcement is None:
            yield (
                f"{place}: '{member.name}.{EVENT}' is in '{named.unit}', not in 's'; it is not "
                "taken for an announcement of jumps"
            )
    for link in (*resolved.links, *resolved.discrete_links):
        if link.doubt:
            yield f"{place}: connection '{link.name}': {link.doubt}"


def _out_of_range(
    resolved: ResolvedSystem, variants: Iterable[Variant], place: str
) -> Iterator[str]:
    """A line for each start value that the FMU's own minimum or maximum excludes."""
    given = [
        (member, item.variable.name, item.value, f"component '{member.name}'")
        for member in resolved.members
        for item in member.start
    ]
    members = {member.name: member for member in resolved.members}
    for variant in variants:
        for setting, value in variant.settings.items():
            owner, _, name = setting.partition(".")
            if owner in members:
                given.append((members[owner], name, value, f"variant '{variant.name}'"))
    for member, name, value, where in given:
        variable = member.description.variables[name]
        if isinstance(value, bool | str):
            continue
        below = variable.least is not None and value < variable.least
        if below or (variable.most is not None and value > variable.most):
            bound = f"min = {variable.least:g}" if below else f"max = {variable.most:g}"
            column = f"{member.name}.{name}"
            yield f"{place}: {where}: '{column}' = {value:g}, where its FMU states {bound}"


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
