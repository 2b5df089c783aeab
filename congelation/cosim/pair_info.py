"""What FMUs are, and the communication steps that a pair of them can take with held inputs.

Most co-simulation tools hold inputs over a communication step. In a loop of high gain that delay
decides whether the loop is stable and how wrong it is, so the longest step is the first thing to
know. It is found by trial: the pair is run from its start values with shorter and shorter steps,
and compared with the accurate coupling.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from congelation.arguments import checked
from congelation.cosim.master import simulate
from congelation.cosim.pool import SlavePool
from congelation.cosim.recording import Output
from congelation.cosim.system import Component, Connection, System
from congelation.errors import CongelationError, InvalidInput
from congelation.fmi.info import FmuInfo, fmu_info

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
    """

    connections: tuple[str, ...]
    stop_time: float
    stable_step: float | None
    accurate_step: float | None
    extrapolated: bool
    trials: tuple[Trial, ...]
    how: str

    def __str__(self) -> str:
        lines = ["the pair, connected by name", *(f"  {link}" for link in self.connections), ""]
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
        the FMUs propose.

    Returns
    -------
    Info
        ``print`` shows it as text.

    Raises
    ------
    InvalidInput
        A file is no FMU for co-simulation under FMI 2.0, or two have nothing to connect.

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
    if stop_time is None:
        stop_time = min(proposed, default=DEFAULT_STOP_TIME)
    if not (math.isfinite(stop_time) and stop_time > 0.0):
        raise InvalidInput(f"stop time {stop_time:g} is not valid; give seconds, more than 0")
    return Info(found, _pair(found[0], found[1], stop_time))


def _pair(one: FmuInfo, two: FmuInfo, stop_time: float) -> PairInfo:
    names = (one.path.stem, two.path.stem)
    if names[0] == names[1]:
        names = (f"{names[0]}_1", f"{names[1]}_2")
    connections = [
        Connection(f"{source}.{entry.name}", f"{target}.{entry.name}")
        for source, target, giver, taker in ((*names, one, two), (*names[::-1], two, one))
        for entry in taker.connect
        if entry.name in {output.name for output in giver.outputs}
    ]
    if not connections:
        raise InvalidInput(
            f"{one.path.name} and {two.path.name} have nothing to connect: no output of the one "
            "has the name of an input of the other"
        )
    components = (Component(names[0], one.path), Component(names[1], two.path))
    system = System(components, tuple(connections))
    links = tuple(map(str, connections))
    driven = {connection.target for connection in connections}
    left = {
        name: [entry.name for entry in fmu.connect if f"{name}.{entry.name}" not in driven]
        for name, fmu in zip(names, (one, two), strict=True)
    }
    alone = [
        f"{name}.{', '.join(left[name])}"
        for name, fmu in zip(names, (one, two), strict=True)
        if left[name] and len(left[name]) == len(fmu.connect)
    ]
    if alone:
        how = (
            f"Steps are not searched for: no output of the other FMU has the name of {alone[0]}, "
            "so this is no closed loop."
        )
        return PairInfo(links, stop_time, None, None, False, (), how)
    stuck = [fmu.path.name for fmu in (one, two) if not (fmu.saves_state and fmu.varies_step)]
    if stuck:
        how = (
            f"Steps are not searched for: {' and '.join(stuck)} cannot take steps back, which the "
            "accurate coupling needs."
        )
        return PairInfo(links, stop_time, None, None, False, (), how)
    try:
        with SlavePool() as pool:
            return _searched(system, links, stop_time, pool)
    except _NoReference as error:
        how = f"Steps are not searched for: the accurate coupling does not get there. {error}"
        return PairInfo(links, stop_time, None, None, False, (), how)


class _NoReference(CongelationError):
    """The accurate run did not reach the stop time."""


def _searched(
    system: System, links: tuple[str, ...], stop_time: float, pool: SlavePool
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
