"""The tables of a scenario file, or of a scenario composed in Python: read, and checked."""

from __future__ import annotations

import difflib
import os
import shlex
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from congelation import keys
from congelation.cosim.system import Component, Connection, Recorded, ResolvedSystem, System
from congelation.errors import InvalidInput
from congelation.export.manifest import outdated
from congelation.fmi.description import describe
from congelation.scenario.doubts import doubts
from congelation.scenario.metrics import Metric, metric
from congelation.scenario.parts import (
    EXPERIMENT,
    Experiment,
    FigureSpec,
    MetricSpec,
    Variant,
    agreed,
)
from congelation.scenario.read_sweep import read_sweep
from congelation.scenario.settings import SettingsReader, component_values, in_own_unit
from congelation.toml import Section, folders_of

__all__ = ["read_scenario"]


def read_scenario(document: Section, stem: str) -> dict[str, Any]:
    """The fields of the scenario that a document describes.

    `stem` names the variant of a scenario that has none.
    """
    top = document.read(keys.SCENARIO)
    if not top["title"].isprintable():
        raise document.wrong("title", "characters that can be shown, in one line")
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
    metrics = tuple(_metric(s, name, resolved) for name, s in top["metrics"].subsections())
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
    varied = [name for variant in variants for name in variant.settings]
    varied += () if sweep is None else sweep.names()
    _refuse_twins(document, "metrics", (spec.name for spec in metrics))
    _refuse_twins(document, "sweep" if sweep else "variants", varied)
    left_open = document.attempt("open", partial(_open, resolved, reader.driven, top["open"]))
    given = {f"{c.name}.{name}" for c in components for name in c.start} | {*varied}
    known = {*left_open, *reader.driven}
    doubtful = doubts(resolved, experiment, metrics, variants, sweep, given, known)
    described = [member.description for member in resolved.members]
    stale = dict.fromkeys(outdated(d.path, d.sha256) for d in described)
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
        "warnings": tuple(f"{document.file}: {line}" for line in (*doubtful, *stale) if line),
    }


def _refuse_twins(document: Section, key: str, names: Iterable[str]) -> None:
    """Raise InvalidInput where two names differ by case alone: SQLite takes them for one column."""
    known: dict[str, str] = {}
    for name in names:
        if (other := known.setdefault(name.lower(), name)) != name:
            raise document.error(
                key,
                f"name '{other}' and '{name}', which differ by case alone; result files "
                "cannot keep them apart",
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
    homes = folders_of(section.file)
    if name.endswith(".fmu"):
        if native:
            raise section.error(
                "native",
                f"= true goes with a name, and fmu = '{name}' is a path; leave native out, or give "
                f'fmu = "{Path(name).stem}"',
            )
        return next((home / name for home in homes if os.path.isfile(home / name)), homes[0] / name)
    where = "fmus/native" if native else "fmus"
    around = [*(folder for home in homes for folder in (home, *home.parents)), Path.cwd()]
    folders = [folder / where for folder in around]
    for folder in folders:
        if os.path.isfile(folder / f"{name}.fmu"):
            return folder / f"{name}.fmu"
    built = sorted({f.stem for folder in folders for f in folder.glob("*.fmu")})
    # Beside the FMUs of other plants, only a slip of the pen is what was meant.
    near = difflib.get_close_matches(name, built, n=1, cutoff=0.8)
    spec = _spec_of(name, around)
    if spec is not None:
        near = []
    build = f"build it with: congelation build {spec or 'SPEC.toml'}{' --native' if native else ''}"
    remedy = f"did you mean '{near[0]}'? Or {build}" if near else build
    raise section.error("fmu", f"= '{name}' is no FMU in {where}/; {remedy}")


def _spec_of(name: str, folders: Iterable[Path]) -> str | None:
    """The spec in one of some folders, or in the folder specs of one, that builds an FMU of this
    name, as a shell takes it."""
    for folder in folders:
        for file in sorted([*folder.glob("*.toml"), *folder.glob("specs/*.toml")]):
            try:
                tables = tomllib.loads(file.read_text("utf-8-sig"))
            except (OSError, ValueError, RecursionError):
                continue  # no spec; what is wrong with the file is no matter of this scenario
            if "form" in tables and any(
                isinstance(table, Mapping) and table.get("name") == name
                for table in map(tables.get, ("plant", "controller", "block"))
            ):
                return shlex.quote(os.path.relpath(file))
    return None


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


def _metric(section: Section, name: str, resolved: ResolvedSystem) -> MetricSpec:
    if "." in name or not name.strip() or not name.isprintable():
        raise section.within(f"choose a name other than '{name}'")
    read = section.read(keys.METRIC)
    found = section.attempt("metric", partial(metric, read["metric"]))
    of = () if found.loop else ("of",)
    section.require(*of).only(("metric", *of, *found.options))
    section.require(*(option for option, required in found.options.items() if required))
    options: dict[str, float] = {}
    for key in found.options:
        if key in found.times and key in section.data:
            options[key] = section.as_kind(key, "time")
        elif isinstance(section.data.get(key), Mapping):
            options[key] = _measured(section, key, found, resolved)
        elif key in section.data:
            options[key] = section.as_kind(key, "number")
    for key in found.positive:
        if options.get(key, 1.0) <= 0.0:
            raise section.wrong(key, "a positive number")
    return MetricSpec(name, found.name, section.as_kind("of", "text") if of else "", options)


def _measured(section: Section, key: str, found: Metric, resolved: ResolvedSystem) -> float:
    """An option of a metric that states its unit, in that of the variables that are measured."""
    if key not in found.values:
        raise section.error(key, "takes no unit; give a number")
    columns = section.attempt("of", partial(resolved.recorded, [section.as_kind("of", "text")]))
    description = resolved.members[columns[0].member].description
    value = in_own_unit(section, key, [column.variable for column in columns], description)
    number: float = replace(section, data={key: value}).as_kind(key, "number")
    return number


LONGEST_NAME = 200
"""Bytes; file systems take names of 255, and what is added to one is shorter than the rest."""


def _figure(section: Section) -> FigureSpec:
    read = section.read(keys.FIGURE)
    name, panels, span = read["name"], read["panels"], read["span"]
    if not name.replace("_", "").replace("-", "").isalnum() or len(name.encode()) > LONGEST_NAME:
        raise section.wrong(
            "name", f"up to {LONGEST_NAME} letters, digits, - and _, as it names a file"
        )
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
        if not name.isprintable():
            raise section.wrong("name", "characters that can be shown, in one line")
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
