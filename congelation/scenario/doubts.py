"""What a scenario says that may not be meant, one line for each doubt."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from congelation.cosim.system import Member, ResolvedSystem
from congelation.fmi.description import EVENT
from congelation.scenario.axes import DISTRIBUTIONS, Sweep
from congelation.scenario.parts import EXPERIMENT, Experiment, MetricSpec, Variant

__all__ = ["doubts"]


def doubts(
    resolved: ResolvedSystem,
    experiment: Experiment,
    metrics: Sequence[MetricSpec],
    variants: Sequence[Variant],
    sweep: Sweep | None,
    given: Collection[str],
    served: Collection[str],
) -> Iterator[str]:
    """All doubts about a scenario.

    Parameters
    ----------
    resolved : ResolvedSystem
    experiment : Experiment
    metrics : sequence of MetricSpec
    variants : sequence of Variant
    sweep : Sweep, optional
    given : collection of str
        What start values, variants and axes set: ``component.variable``, ``experiment.key``.
    served : collection of str
        Inputs that are driven or meant to be left open.
    """
    yield from _links(resolved)
    settings = list(_settings(resolved, variants, sweep))
    yield from dict.fromkeys(_out_of_range(settings))
    yield from dict.fromkeys(_too_fast(settings, experiment, given))
    yield from dict.fromkeys(_of_no_term(settings))
    yield from _mixed(resolved, metrics)
    yield from _past_the_end(metrics, experiment, given)
    yield from _forgotten(resolved, {*given, *served})


def _past_the_end(
    metrics: Sequence[MetricSpec], experiment: Experiment, given: Collection[str]
) -> Iterator[str]:
    """A line for a step that is longer than every run, and for each metric of later times."""
    if f"{EXPERIMENT}.stop_time" in given:
        return
    horizon, step = experiment.stop_time - experiment.start_time, experiment.step
    fixed = experiment.tolerance is None and f"{EXPERIMENT}.step" not in given
    if fixed and step is not None and step > horizon:
        yield (
            f"{EXPERIMENT}.step = {step:g} is longer than the run, {horizon:g} s, which is one step"
        )
    for found in metrics:
        after = found.options.get("after", -math.inf)
        if -math.inf < after < experiment.start_time:
            yield (
                f"metrics.{found.name}.after = {after:g} is before start_time = "
                f"{experiment.start_time:g}: it has no effect"
            )
        if after > experiment.stop_time:
            yield (
                f"metrics.{found.name}.after = {after:g} is past stop_time = "
                f"{experiment.stop_time:g}: the metric has no value"
            )


def _mixed(resolved: ResolvedSystem, metrics: Iterable[MetricSpec]) -> Iterator[str]:
    """A line for each metric that takes the norm of elements in different units, or that computes
    with the numbers of an enumeration."""
    for found in metrics:
        columns = resolved.recorded([found.of]) if found.of else ()
        if any(column.variable.items for column in columns):
            yield (
                f"metrics.{found.name}: '{found.of}' is an enumeration, whose numbers stand for "
                "names; what is computed from them depends on how the items are numbered"
            )
        units = {column.variable.unit for column in columns}
        if len(units) > 1:
            names = ", ".join(f"'{unit}'" for unit in sorted(units))
            yield (
                f"metrics.{found.name}: '{found.of}' has elements in {names}, whose norm "
                "depends on the units; give a metric of each element"
            )


def _links(resolved: ResolvedSystem) -> Iterator[str]:
    """A line for each connection whose units or enumerations cannot be compared, and for each
    announcement of jumps that is no time in seconds."""
    for member in resolved.members:
        named = member.description.variables.get(EVENT)
        if named is not None and named.unit and member.description.announcement is None:
            yield (
                f"'{member.name}.{EVENT}' is in '{named.unit}', not in 's'; it is not "
                "taken for an announcement of jumps"
            )
    for link in (*resolved.links, *resolved.discrete_links):
        if link.doubt:
            yield f"connection '{link.name}': {link.doubt}"


class _Setting(NamedTuple):
    """A number that a variable starts from in some run, and what says so."""

    member: Member
    name: str
    value: float
    source: str

    @property
    def is_start(self) -> bool:
        """Whether it is a start value of the component itself, which gives every term."""
        return self.source.startswith("component ")

    @property
    def column(self) -> str:
        """The variable with its component."""
        return f"{self.member.name}.{self.name}"

    @property
    def turns(self) -> Callable[[float], float] | None:
        """Of the number of a profile that says how often it turns: how many times in a second."""
        term, _, number = self.name.rpartition(".")
        kind = re.sub(r"^.*\.|\[\d+\]$", "", term)
        return _TURNS.get(f"{kind}.{number}")

    @property
    def size(self) -> str:
        """The variable with the amplitude of the same term."""
        term = self.column.rpartition(".")[0]
        return f"{term}.deviation" if ".noise[" in term else f"{term}.amplitude"


def _settings(
    resolved: ResolvedSystem, variants: Iterable[Variant], sweep: Sweep | None
) -> Iterator[_Setting]:
    """The numbers of start values, variants and axes; of random axes, the ends of their range."""
    for member in resolved.members:
        for item in member.start:
            if not isinstance(item.value, bool | str):
                source = f"component '{member.name}'"
                yield _Setting(member, item.variable.name, item.value, source)
    changes = [(f"variant '{v.name}'", list(v.settings.items())) for v in variants]
    if sweep is not None:
        listed = [(key, v) for axis in sweep.lists for entry in axis for key, v in entry.items()]
        drawn = [
            (axis.name, end)
            for axis in sweep.axes
            if DISTRIBUTIONS[axis.distribution].bounded
            for end in axis.parameters
        ]
        changes.append(("sweep", [*listed, *drawn]))
    members = {member.name: member for member in resolved.members}
    for source, settings in changes:
        for setting, value in settings:
            owner, _, name = setting.partition(".")
            if owner in members and not isinstance(value, bool | str):
                yield _Setting(members[owner], name, value, source)


def _sizes(settings: Collection[_Setting]) -> set[str]:
    """The amplitudes that are not 0 in some run: as given, or the FMU's own unless replaced."""
    replaced = {item.column for item in settings if item.is_start}
    sizes = {item.column for item in settings if item.value}
    for item in settings:
        if item.turns is not None and item.size not in replaced:
            own = item.member.description.variables[item.size.partition(".")[2]].default
            if own and float(own):
                sizes.add(item.size)
    return sizes


def _of_no_term(settings: Collection[_Setting]) -> Iterator[str]:
    """A line for each number of a term that no profile has: nothing gives it an amplitude."""
    sizes = _sizes(settings)
    for item in settings:
        if not item.is_start and item.turns is not None and item.size not in sizes:
            yield (
                f"{item.source}: '{item.column}' has no effect, as the profile has no such term: "
                f"'{item.size}' is 0"
            )


def _out_of_range(settings: Iterable[_Setting]) -> Iterator[str]:
    """A line for each start value that the FMU's own minimum or maximum excludes."""
    for given in settings:
        variable = given.member.description.variables[given.name]
        below = variable.least is not None and given.value < variable.least
        if below or (variable.most is not None and given.value > variable.most):
            bound = f"min = {variable.least:g}" if below else f"max = {variable.most:g}"
            yield (
                f"{given.source}: '{given.column}' = {given.value:g}, where its FMU states {bound}"
            )


MOST_PERIODS = 1e8
"""In a run; with more, the steps that resolve them all take hours at the least."""

# The numbers of a profile that say how often it turns, and how many times in a second.
_TURNS: Mapping[str, Callable[[float], float]] = {
    "square.period": lambda period: 1.0 / period,
    "telegraph.rate": abs,
    "sine.omega": lambda omega: abs(omega) / math.tau,
    "chirp.omega_start": lambda omega: abs(omega) / math.tau,
    "chirp.omega_end": lambda omega: abs(omega) / math.tau,
    "noise.sample_time": lambda time: 1.0 / time,
}


def _too_fast(
    settings: Collection[_Setting], experiment: Experiment, given: Collection[str]
) -> Iterator[str]:
    """A line for each profile that turns so often in a run that no steps resolve it."""
    if f"{EXPERIMENT}.stop_time" in given:
        return
    horizon = experiment.stop_time - experiment.start_time
    sizes = _sizes(settings)
    for item in settings:
        if item.turns is None or item.size not in sizes:
            continue
        times = horizon * item.turns(item.value)
        if times > MOST_PERIODS:
            yield (
                f"{item.source}: '{item.column}' = {item.value:g} makes {times:.2g} periods or "
                f"jumps in a run of {horizon:g} s, more than steps can resolve"
            )


def _forgotten(resolved: ResolvedSystem, known: Collection[str]) -> Iterator[str]:
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
                    f"input '{member.name}.{name}' has no connection and no start value; "
                    f'connect it, set it, or list it in open = ["{member.name}.{name}"]'
                )
