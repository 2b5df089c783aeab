"""What FMUs are, and the communication steps that a pair of them can take with held inputs.

Most co-simulation tools hold inputs over a communication step. In a loop of high gain that delay
decides whether the loop is stable and how wrong it is, so the longest step is the first thing to
know. It is found by trial: the pair is run from its start values with shorter and shorter steps,
and compared with the accurate coupling.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from congelation.arguments import checked
from congelation.cosim.master import simulate
from congelation.cosim.pool import SlavePool
from congelation.cosim.recording import Output
from congelation.cosim.system import Component, Connection, System
from congelation.errors import CongelationError, InvalidInput
from congelation.fmi.description import EVENT
from congelation.fmi.info import FmuInfo, VariableInfo, fmu_info

__all__ = ["Info", "PairInfo", "Trial", "info"]

STABLE, ACCURATE = 1.0, 0.01
"""Errors, relative to each output's peak: as large as the answer, and 1 %."""

COARSEST = 10
"""Communication steps of the first trial; each further one takes twice as many."""

MOST_STEPS = 20_000
"""Most steps of a trial, about a second; beyond it the step for 1 % is extrapolated."""

SHORTEST = 2.0**-12
"""Smallest part of the horizon that trials are cut to where no longer step has an error of 1 %."""

RESOLUTION = 1.05
"""Ratio of an unstable step to a stable one at which the search for the limit ends."""

REFERENCE_TOLERANCE = 1e-6
DEFAULT_STOP_TIME = 10.0

NAMED = 6
"""Names that a message lists at most."""


@dataclass(frozen=True)
class Trial:
    """A run with held inputs: its communication step in seconds, and its relative error."""

    step: float
    error: float


@dataclass(frozen=True)
class PairInfo:
    """What was found of two FMUs connected with each other by the names of their variables.

    Attributes
    ----------
    connections : tuple of str
        ``output -> input``.
    stop_time : float
        Seconds that the trial runs took; of several horizons the last and shortest.
    stable_step, accurate_step : float or None
        Largest communication steps, in seconds, with an error below the size of the answer, and of
        1 %; None if they are shorter than all steps that were tried.
    extrapolated : bool
        Whether `accurate_step` follows from the error at the shortest step tried, to which it is
        proportional.
    trials : tuple of Trial
        By falling step.
    how : str
        How the steps were found, or why they were not.
    warnings : tuple of str
        What may not fit: units that cannot be compared, FMUs of different specs.
    """

    connections: tuple[str, ...]
    stop_time: float
    stable_step: float | None
    accurate_step: float | None
    extrapolated: bool
    trials: tuple[Trial, ...]
    how: str
    warnings: tuple[str, ...] = ()

    def __str__(self) -> str:
        lines = ["the pair, connected by name", *(f"  {link}" for link in self.connections)]
        lines += [*(f"warning: {line}" for line in self.warnings), ""]
        if self.trials:
            lines += [
                "largest communication step with held inputs",
                f"  stable    {self._text(self.stable_step, STABLE)}",
                f"  1 % error {self._text(self.accurate_step, ACCURATE)}"
                + (", extrapolated" if self.extrapolated else ""),
            ]
        return "\n".join([*lines, self.how])

    def _text(self, step: float | None, level: float) -> str:
        if step is None:
            return f"less than {self.trials[-1].step:.2g} s"
        longest = self.trials[0]
        more = " or more" if step == longest.step and longest.error <= level else ""
        return f"{step:.2g} s{more}"


@dataclass(frozen=True)
class Info:
    """What FMUs are, and what they can do together.

    Attributes
    ----------
    fmus : tuple of FmuInfo
    pair : PairInfo or None
        Of two FMUs.

    Examples
    --------
    >>> cg.info("fmus/ScalarPlant.fmu").fmus[0].name
    'ScalarPlant'
    """

    fmus: tuple[FmuInfo, ...]
    pair: PairInfo | None = None

    def __str__(self) -> str:
        parts = [str(fmu) for fmu in self.fmus]
        return "\n\n".join(parts if self.pair is None else [*parts, str(self.pair)])


@checked
def info(*fmus: Path | str, stop_time: float | None = None) -> Info:
    """Say what an FMU is; of a pair, which communication steps it can take with held inputs.

    Parameters
    ----------
    *fmus : Path or str
        One FMU, or two that are connected with each other by the names of their variables, such as
        a plant and its controller.
    stop_time : float, optional
        Seconds that the trial runs of a pair take; by default the shorter of the stop times that
        the FMUs propose, or 10 where they propose none.

    Returns
    -------
    Info
        ``print`` shows it as text.

    Raises
    ------
    InvalidInput
        A file is no FMU for co-simulation under FMI 2.0, or two have nothing to connect, or do
        not fit: designs of different forms or orders, vectors of different lengths, units that
        measure different things.

    Examples
    --------
    >>> found = cg.info(fmus / "ScalarController.fmu")
    >>> [v.name for v in found.fmus[0].connect]
    ['x']
    >>> found = cg.info(fmus / "ScalarPlant.fmu", fmus / "ScalarController.fmu", stop_time=2.0)
    >>> found.pair.accurate_step < found.pair.stable_step
    True
    """
    if len(fmus) not in (1, 2):
        raise InvalidInput(f"{len(fmus)} FMUs are given; give one, or two to connect")
    found = tuple(fmu_info(Path(fmu)) for fmu in fmus)
    if len(found) == 1:
        if stop_time is not None:
            raise InvalidInput("a stop time is of the trial runs of a pair; give a second FMU")
        return Info(found)
    proposed = [fmu.stop_time for fmu in found if fmu.stop_time]
    whence = ""
    if stop_time is None:
        stop_time = min(proposed, default=DEFAULT_STOP_TIME)
        whence = "the stop time that the FMUs propose" if proposed else "as the FMUs propose none"
    if not (math.isfinite(stop_time) and stop_time > 0.0):
        raise InvalidInput(f"stop time {stop_time:g} is not valid; give seconds, more than 0")
    return Info(found, _pair(found[0], found[1], stop_time, whence))


def _pair(one: FmuInfo, two: FmuInfo, stop_time: float, whence: str) -> PairInfo:
    """What two FMUs do together; `whence` says why the runs end at `stop_time` by default."""
    system, warnings = _connected(one, two)
    links = tuple(map(str, system.connections))
    names = [component.name for component in system.components]

    def unsearched(reason: str) -> PairInfo:
        how = f"Steps are not searched for: {reason}"
        return PairInfo(links, stop_time, None, None, False, (), how, warnings)

    driven = {connection.target for connection in system.connections}
    for name, fmu, other in zip(names, (one, two), (two, one), strict=True):
        if fmu.connect and driven.isdisjoint(f"{name}.{entry.name}" for entry in fmu.connect):
            return unsearched(
                f"nothing drives {name}, so this is no closed loop; {other.path.name} has the "
                f"outputs {_listed(_proper(other.outputs))}."
            )
    stuck = [fmu.path.name for fmu in (one, two) if not (fmu.saves_state and fmu.varies_step)]
    if stuck:
        return unsearched(
            f"{' and '.join(stuck)} cannot take steps back, which the accurate coupling needs."
        )
    try:
        with SlavePool() as pool:
            return replace(_searched(system, links, stop_time, whence, pool), warnings=warnings)
    except _NoReference as error:
        return unsearched(f"the accurate coupling does not get there. {error}")


def _connected(one: FmuInfo, two: FmuInfo) -> tuple[System, tuple[str, ...]]:
    """Two FMUs connected by the names of their variables, and what may not fit of them.

    Raises
    ------
    InvalidInput
        They have nothing to connect, or do not fit; everything that does not is named.
    """
    names = (one.path.stem, two.path.stem)
    if names[0] == names[1]:
        names = (f"{names[0]}_1", f"{names[1]}_2")
    connections = tuple(
        Connection(f"{source}.{entry.name}", f"{target}.{entry.name}")
        for source, target, giver, taker in ((*names, one, two), (*names[::-1], two, one))
        for entry in taker.connect
        if entry.name in {output.name for output in giver.outputs}
    )
    components = (Component(names[0], one.path), Component(names[1], two.path))
    misfits = [*_of_vectors(one, two), *_of_vectors(two, one)]
    doubts = []
    for connection in connections:
        try:
            resolved = System(components, (connection,)).resolve(held=True)
        except InvalidInput as error:
            misfits.append(str(error))
        else:
            links = (*resolved.links, *resolved.discrete_links)
            doubts += [f"connection '{link.name}': {link.doubt}" for link in links if link.doubt]
    driven = {connection.target for connection in connections}
    undriven = [
        f"no output of {other.path.name} has the name of {name}.{', '.join(left)}"
        for name, fmu, other in zip(names, (one, two), (two, one), strict=True)
        if (left := [v.name for v in fmu.connect if f"{name}.{v.name}" not in driven])
    ]
    # A law for another form may still run on a plant whose names and units agree.
    of_designs = [*_of_designs(one, two)]
    if misfits or (of_designs and undriven):
        partners = [
            f"{fmu.path.name} was built with {partner}.fmu"
            for fmu in (one, two)
            if (partner := _partner(fmu)) is not None
        ]
        what = "; ".join([*of_designs, *(misfits or undriven)])
        remedy = "; ".join(partners) or "give FMUs whose outputs and inputs agree in name and unit"
        raise InvalidInput(f"{one.path.name} and {two.path.name} do not fit: {what}; {remedy}")
    if not connections:
        has = "; ".join(
            f"{fmu.path.name} has the outputs {_listed(_proper(fmu.outputs))} and the inputs "
            f"{_listed(fmu.connect)}"
            for fmu in (one, two)
        )
        raise InvalidInput(
            f"{one.path.name} and {two.path.name} have nothing to connect: no output of the one "
            f"has the name of an input of the other; {has}"
        )
    specs = [fmu.design for fmu in (one, two) if fmu.design is not None and _partner(fmu)]
    if len({(spec.plant, spec.controller) for spec in specs}) > 1:
        titles = " and ".join(f"'{spec.title}'" for spec in specs)
        of_designs.append(
            f"they were built from different specs, {titles}: the law is that for the plant of "
            "its own spec"
        )
    return System(components, connections), (*doubts, *undriven, *of_designs)


def _of_designs(one: FmuInfo, two: FmuInfo) -> Iterator[str]:
    """That a plant and a controller of `congelation build` are of other forms or orders."""
    designs = [fmu.design for fmu in (one, two) if fmu.design is not None]
    if {design.role for design in designs} != {"plant", "controller"}:
        return
    plant, controller = sorted(designs, key=lambda design: design.role != "plant")
    if plant.form != controller.form:
        yield f"the plant is of the form '{plant.form}', the controller of '{controller.form}'"
    if plant.order != controller.order and None not in (plant.order, controller.order):
        yield f"the plant is of order {plant.order}, the controller of order {controller.order}"


def _of_vectors(giver: FmuInfo, taker: FmuInfo) -> Iterator[str]:
    """Each vector of inputs of the one that the other gives with other indices.

    A scalar and a vector of one element, u and u[1], have other names but the same size.
    """
    given, taken = (_indices(entries) for entries in (giver.outputs, taker.connect))
    for name in taken.keys() & given.keys():
        if given[name] != taken[name] and len(given[name] | taken[name]) > 2:
            gives, takes = (
                ", ".join(f"{name}{index}" for index in sorted(indices))
                for indices in (given[name], taken[name])
            )
            yield f"{giver.path.name} gives {gives}, and {taker.path.name} takes {takes}"


def _indices(entries: Iterable[VariableInfo]) -> dict[str, set[str]]:
    """The indices of each vector, written ``[1]``; a scalar has the empty one."""
    found: dict[str, set[str]] = {}
    for entry in entries:
        name, bracket, rest = entry.name.partition("[")
        found.setdefault(name, set()).add(bracket + rest)
    return found


def _partner(fmu: FmuInfo) -> str | None:
    """The other FMU of the same spec."""
    if fmu.design is None or fmu.design.role not in ("plant", "controller"):
        return None
    return fmu.design.controller if fmu.design.role == "plant" else fmu.design.plant


def _proper(outputs: Iterable[VariableInfo]) -> list[VariableInfo]:
    """Without derivatives and the announcement of jumps."""
    return [entry for entry in outputs if not entry.name.startswith(("der(", EVENT))]


def _listed(entries: Iterable[VariableInfo]) -> str:
    """The names of variables in a row, the first of many."""
    names = [entry.name for entry in entries]
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more or "none"


class _NoReference(CongelationError):
    """The accurate run did not reach the stop time."""


def _searched(
    system: System, links: tuple[str, ...], stop_time: float, whence: str, pool: SlavePool
) -> PairInfo:
    """Halve the step until the error is 1 %, then find the two limits between the trials."""
    record = [str(connection.source) for connection in system.connections]
    trials: list[Trial] = []
    horizons: dict[float, float] = {}

    def run(steps: int, horizon: float) -> Trial:
        step = horizon / steps
        horizons[step] = horizon
        trials.append(Trial(step, _error(system, horizon, step, record, pool)))
        return trials[-1]

    horizon, steps = stop_time, COARSEST
    while run(steps, horizon).error > ACCURATE:
        if 2 * steps <= MOST_STEPS:
            steps *= 2
        elif _accurate(trials)[0] is None and horizon > SHORTEST * stop_time:
            horizon /= 2.0  # with as many steps, so that this trial takes no longer than the last
        else:
            break
    scan = list(trials)

    # The limit of stability lies between the last unstable step and the next, if there is one: an
    # unstable loop can look harmless at steps so long that few values are compared.
    unstable = [k for k, trial in enumerate(scan) if trial.error > STABLE]
    stable_step: float | None = scan[0].step
    if unstable and unstable[-1] == len(scan) - 1:
        stable_step = None
    elif unstable:
        long, short = scan[unstable[-1]].step, scan[unstable[-1] + 1].step
        while long / short > RESOLUTION:
            span = horizons[short]  # on a shorter one, an unstable step might not have shown yet
            middle = run(max(1, round(span / math.sqrt(long * short))), span)
            if middle.error > STABLE:
                long = middle.step
            else:
                short = middle.step
        stable_step = short

    trials.sort(key=lambda trial: -trial.step)
    accurate_step, extrapolated = _accurate(scan)
    how = (
        f"Found by runs from the start values to t = {horizon:g} s with held inputs (jacobi), "
        f"compared with the coupling 'hermite' at tolerance {REFERENCE_TOLERANCE:g}. The error is "
        "the largest distance of a connected output, relative to its peak; a step counts as stable "
        "where it is below 100 %. Other parameters, start values or profiles have other limits."
    )
    if whence:
        how += (
            f" The runs end at {stop_time:g} s, {whence}; a loop that needs longer to show what it "
            "does wants a longer stop time (--stop-time)."
        )
    if horizon < stop_time:
        how += (
            f" Steps below {stop_time / steps:.2g} s were tried over ever shorter times, the last "
            f"to t = {horizon:g} s; the loop may need still shorter ones later."
        )
    return PairInfo(links, horizon, stable_step, accurate_step, extrapolated, tuple(trials), how)


def _accurate(scan: Sequence[Trial]) -> tuple[float | None, bool]:
    """The step with an error of 1 %, and whether it is extrapolated; held inputs are of order 1."""
    last = scan[-1]
    if len(scan) == 1:
        return (last.step, False) if last.error <= ACCURATE else (None, False)
    before = scan[-2]
    if last.error <= ACCURATE:
        if before.error >= STABLE or last.error == 0.0:
            return last.step, False
        # A straight line through both in logarithms.
        order = math.log(before.error / last.error) / math.log(before.step / last.step)
        return last.step * (ACCURATE / last.error) ** (1.0 / order), False
    halved = before.error / last.error if math.isfinite(before.error) else math.inf
    # Only where halving the step halved the error is the error known to go on like that.
    if 1.7 < halved < 2.4:
        return last.step * ACCURATE / last.error, True
    return None, False


def _error(
    system: System, stop_time: float, step: float, record: Sequence[str], pool: SlavePool
) -> float:
    """The largest relative error of a run with held inputs; infinite if it did not get through."""
    held = simulate(
        system, stop_time=stop_time, step=step, coupling="jacobi", record=record, pool=pool
    )
    if not held.completed:
        return math.inf
    exact = simulate(
        system,
        stop_time=stop_time,
        tolerance=REFERENCE_TOLERANCE,
        coupling="hermite",
        record=record,
        output=Output(interval=step),
        pool=pool,
    )
    if not exact.completed:
        raise _NoReference(exact.message)
    peaks: npt.NDArray[np.float64] = np.max(np.abs(exact.values), axis=0)
    errors = np.max(np.abs(held.values - exact.values), axis=0)
    # An output that stays 0 has no size to compare with.
    return float(np.max(np.where(peaks > 0.0, errors / np.where(peaks > 0.0, peaks, 1.0), errors)))
