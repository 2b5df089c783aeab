"""Scenario files: TOML in, a checked `Scenario` out.

Everything is checked when the file is read, against the model descriptions of the FMUs, so that
a mistake is told with its place in the file before anything runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from congelation.cosim.system import Component, Connection, Recorded, System
from congelation.errors import InvalidInput, nearest
from congelation.fmi.description import describe
from congelation.scenario.metrics import metric
from congelation.scenario.scenario import (
    EXPERIMENT,
    Case,
    FigureSpec,
    MetricSpec,
    Scenario,
    Variant,
)
from congelation.scenario.start_values import Scalar, profile_values, start_values
from congelation.scenario.sweep_table import Flatten, read_sweep
from congelation.toml import Section, read_document

__all__ = ["load_scenario", "read_scenario"]

_KEYS = (
    "title",
    "connections",
    "components",
    EXPERIMENT,
    "metrics",
    "figures",
    "variants",
    "sweep",
)
# Columns that every row has; a metric of the same name would hide one.
_RESERVED = (
    "run_id",
    "variant",
    "replicate",
    "status",
    "message",
    "macro_steps",
    "wall_time",
    "seed",
    "code_version",
)
_BUILD = "build it with: python build_fmu.py"


def load_scenario(file: Path) -> Scenario:
    """Read a scenario file.

    Raises
    ------
    InvalidInput
        Naming the file, the path of the key, and what would be valid.
    """
    text, document = read_document(file)
    return read_scenario(file, text, document)


def read_scenario(file: Path, text: str, document: Section) -> Scenario:
    """The scenario that a document describes; `text` is what it was read from, for the record.

    Raises
    ------
    InvalidInput
        Naming the file, the path of the key, and what would be valid.
    """
    document.only(_KEYS).require("title", "components", EXPERIMENT)
    tables = document.section("components").subsections()
    components = tuple(_component(section, name) for name, section in tables)
    connections = tuple(
        document.attempt("connections", partial(Connection.parse, connection))
        for connection in document.texts("connections")
    )
    scenario = Scenario(
        title=document.text("title"),
        file=file,
        text=text,
        system=System(components, connections),
        experiment=document.section(EXPERIMENT).data,
        metrics=tuple(_metric(s, name) for name, s in document.section("metrics").subsections()),
        figures=tuple(_figure(s) for s in document.sections("figures")),
    )
    scenario = _with_record(document, scenario)
    scenario.case({})
    driven = _driven(scenario)
    for name, section in document.section("components").subsections():
        values = next(c.start for c in scenario.system.components if c.name == name)
        _check_free(section.section("start"), name, values, driven)
    flatten = partial(_settings, scenario=scenario, driven=driven)
    scenario = replace(scenario, variants=_variants(document, scenario, flatten))
    _check_figures(document, scenario)
    if "sweep" not in document.data:
        return scenario
    return replace(scenario, sweep=read_sweep(document.section("sweep"), flatten))


def _component(section: Section, name: str) -> Component:
    section.only(("fmu", "start", "profile"))
    if name == EXPERIMENT:
        raise InvalidInput(f"{section.file}: {section.path}: choose a name other than '{name}'")
    fmu = _find_fmu(section)
    return Component(name, fmu, _values(section, fmu, section.section("start")))


def _values(section: Section, fmu: Path, start: Section) -> dict[str, Scalar]:
    """The values of `start` and of the profile table of `section`, by scalar variable."""
    description = section.attempt("fmu", partial(describe, fmu))
    values = start_values(start, description)
    profile = profile_values(section.section("profile"), description)
    for twice in sorted(values.keys() & profile.keys()):
        raise start.error(twice, "is given by the profile as well; leave one of them out")
    return values | profile


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


def _metric(section: Section, name: str) -> MetricSpec:
    if name in _RESERVED or "." in name or not name.strip():
        raise InvalidInput(f"{section.file}: {section.path}: choose a name other than '{name}'")
    section.require("metric")
    found = section.attempt("metric", partial(metric, section.text("metric")))
    of = () if found.loop else ("of",)
    section.require(*of).only(("metric", *of, *found.options))
    section.require(*(option for option, required in found.options.items() if required))
    options = {key: section.number(key) for key in section.data if key in found.options}
    for key in found.positive:
        if options.get(key, 1.0) <= 0.0:
            raise section.wrong(key, "a positive number")
    return MetricSpec(name, found.name, section.text("of") if of else "", options)


def _figure(section: Section) -> FigureSpec:
    section.only(("name", "panels", "span")).require("panels")
    name = section.text("name")
    if not name.replace("_", "").replace("-", "").isalnum():
        raise section.wrong("name", "letters, digits, - and _, as it names a file")
    if not section.texts("panels"):
        raise section.wrong("panels", "at least one variable")
    span = section.numbers("span")
    if span and (len(span) != 2 or span[0] >= span[1]):
        raise section.wrong("span", "[start, stop] in seconds")
    return FigureSpec(name, section.texts("panels"), (span[0], span[1]) if span else None)


def _check_figures(document: Section, scenario: Scenario) -> None:
    """Raise InvalidInput for a figure that would replace another, or shows no part of any run."""
    runs = [scenario.case(variant.settings).experiment for variant in scenario.variants]
    start, stop = min(run.start_time for run in runs), max(run.stop_time for run in runs)
    names: set[str] = set()
    for figure, section in zip(scenario.figures, document.sections("figures"), strict=True):
        if figure.name in names:
            raise section.error("name", f"= '{figure.name}' is given twice; names must differ")
        names.add(figure.name)
        if figure.span is not None and not (figure.span[0] < stop and figure.span[1] > start):
            raise section.wrong("span", f"a part of the time from {start:g} to {stop:g}")


def _variants(document: Section, scenario: Scenario, flatten: Flatten) -> tuple[Variant, ...]:
    variants: list[Variant] = []
    for section in document.sections("variants"):
        name = section.only(("name", "set")).text("name")
        if any(name == other.name for other in variants):
            raise section.error("name", f"= '{name}' is given twice; names must differ")
        variants.append(Variant(name, flatten(section.section("set"))))
    return tuple(variants) or (Variant(scenario.file.stem, {}),)


def _driven(scenario: Scenario) -> dict[str, str]:
    """The inputs that connections drive, ``component.variable``, and what each is driven by."""
    resolved = scenario.system.resolve()
    found: dict[str, str] = {}
    for link in (*resolved.links, *resolved.discrete_links):
        for variable in (link.input, *link.target_derivatives):
            if variable is not None:
                found[f"{resolved.members[link.target].name}.{variable.name}"] = link.name
    return found


def _check_free(
    section: Section, name: str, values: Iterable[str], driven: Mapping[str, str]
) -> None:
    """Raise InvalidInput where a start value of component `name` is that of a connected input."""
    for variable in values:
        if link := driven.get(f"{name}.{variable}"):
            raise InvalidInput(
                f"{section.file}: {section.path}: '{variable}' has no effect, as '{link}' drives "
                "it; leave one of them out"
            )


def _settings(section: Section, scenario: Scenario, driven: Mapping[str, str]) -> dict[str, Scalar]:
    """The flat settings ``owner.key`` of a variant; owners are the components and `experiment`."""
    owners = _by_owner(section)
    fmus = {component.name: component.fmu for component in scenario.system.components}
    flat: dict[str, Scalar] = {}
    for owner in owners.data:
        if owner not in (*fmus, EXPERIMENT):
            raise section.error(owner, f"is no component; {nearest(owner, (*fmus, EXPERIMENT))}")
        changed = owners.section(owner)
        values = (
            scenario.experiment_values(changed)
            if owner == EXPERIMENT
            else _values(changed, fmus[owner], changed.without("profile"))
        )
        _check_free(changed, owner, values, driven)
        flat |= {f"{owner}.{key}": value for key, value in values.items()}
    scenario.case(flat)
    return flat


def _by_owner(section: Section) -> Section:
    """`section` with its keys ``owner.key`` and ``owner.profile.theta[j]`` as nested tables."""
    grouped: dict[str, dict[str, object]] = {}
    profiles: dict[str, dict[str, object]] = {}
    for name, value in section.data.items():
        owner, dot, key = name.partition(".")
        settings = {key: value} if dot else value
        if not isinstance(settings, Mapping):
            raise section.error(name, "is no setting; write it as 'component.variable'")
        for inner, setting in settings.items():
            of = profiles if inner.startswith("profile.") else grouped
            table = of.setdefault(owner, {})
            if inner.removeprefix("profile.") in table:
                raise section.error(f"{owner}.{inner}", "is given twice; leave one of them out")
            table[inner.removeprefix("profile.")] = setting
    for owner, profile in profiles.items():
        if "profile" in grouped.setdefault(owner, {}):
            raise section.error(f"{owner}.profile", "is given twice; leave one of them out")
        grouped[owner]["profile"] = profile
    return replace(section, data=grouped)


def _with_record(document: Section, scenario: Scenario) -> Scenario:
    """The scenario with the columns to record: what it names, what is measured and drawn.

    An experiment that names none records every number among the outputs.
    """
    try:
        resolved = scenario.system.resolve()
    except InvalidInput as error:
        raise InvalidInput(f"{scenario.file}: {error}") from error
    experiment = document.section(EXPERIMENT)
    wanted = experiment.texts("record") or None
    columns = list(experiment.attempt("record", partial(resolved.recorded, wanted)))
    measured: list[Recorded] = []
    for spec in scenario.metrics:
        section = document.section("metrics").section(spec.name)
        if metric(spec.metric).loop:
            case = replace(scenario, experiment=_recording(experiment, columns)).case({})
            states = section.attempt("metric", partial(_loop_states, case))
            group = section.attempt("metric", partial(resolved.recorded, states))
        else:
            group = section.attempt("of", partial(resolved.recorded, [spec.of]))
            section.attempt("of", partial(metric(spec.metric).check_size, len(group)))
        columns += group
        measured += group
    for figure, section in zip(scenario.figures, document.sections("figures"), strict=True):
        columns += section.attempt("panels", partial(resolved.recorded, figure.variables))
    everything = any(metric(spec.metric).recorded for spec in scenario.metrics)
    return replace(
        scenario,
        experiment=_recording(experiment, columns),
        measured=None if everything else tuple(dict.fromkeys(c.name for c in measured)),
    )


def _recording(experiment: Section, columns: Iterable[Recorded]) -> dict[str, object]:
    return {**experiment.data, "record": list(dict.fromkeys(c.name for c in columns))}


def _loop_states(case: Case) -> tuple[str, ...]:
    # Here, as it brings CasADi, which scenarios without such a metric do without.
    from congelation.verify.lyapunov import loop_states

    return loop_states(case)
