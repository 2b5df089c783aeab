"""Error bars: a run is made again with every step halved, and the difference becomes bands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from congelation.cosim.bands import (
    FLOOR,
    amplified,
    bands,
    error_name,
    late_switches,
    window_maxima,
)
from congelation.cosim.choice import Lack, chosen
from congelation.cosim.coupling import Auto, Derivative, Hermite, ModelExchange
from congelation.cosim.delayed_jumps import KINKED
from congelation.cosim.experiment import Experiment, slave_tolerance
from congelation.cosim.further_runs import Note, observed, probed
from congelation.cosim.pool import SlavePool
from congelation.cosim.recording import Output
from congelation.cosim.rerun import Again, At
from congelation.cosim.rerun_process import Ahead
from congelation.cosim.result import Result, Trust
from congelation.cosim.sinks import Memory
from congelation.cosim.system import Recorded, System
from congelation.errors import InvalidInput

__all__ = ["MOST_LEVELS", "NOT_RESOLVED", "TRUST", "trusted"]

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

TRUST = ("order", "probe")
"""What may be asked for besides the bands."""

STARTING = 4
"""Intervals after the start in which extrapolation by derivatives that come from history is of
order 1. (`hermite` makes ends agree by iterations, so it has its order from the start.)"""

JITTER = 1.3
"""What a band is wider where something switches: delays of up to a step add up at random."""

SHARED = 3.0
"""What a band is wider where a system has amplified the errors of both runs: by chance, both may
have most of it."""

SLAVE_FLOOR = 0.1
"""Of the tolerance of the FMUs: no band is narrower, as theirs in the second run is a hundredth."""

RESOLVED, ROUGH = 0.1, 0.3
"""Largest band over peak up to which a variable counts as resolved, and as rough."""

LOST = 1.01 * ROUGH
"""A band that is just wide enough to say that a variable is not resolved."""

NOT_RESOLVED = "not resolved"

MOST_LEVELS = 8
"""A variable that takes at most so many values, in many more rows, is a switched one."""

ROWS_PER_LEVEL = 8
"""A switched variable has so many rows for each value it may take."""

UNREPEATED = 1e-5
"""Of a variable's peak: two runs that start further apart are no repetition."""

LEAST_ORDER = 0.5
"""Where a lower one is observed, differences say nothing of errors any more."""

ONE_OF_THREE = 1.0 / 3.0
"""The run's part of the work."""

INSIDE = "errors inside an FMU count only as far as they change with the step"


def trusted(
    perform: Callable[..., Result],
    system: System,
    experiment: Experiment,
    mode: bool | str,
    *,
    output: Output | Sequence[Output] | None = None,
    progress: Callable[[float], None] | None = None,
    pool: SlavePool | None = None,
    lacks: Sequence[Lack] = (),
) -> Result:
    """A run with its error bars.

    Parameters
    ----------
    perform : callable
        `congelation.cosim.master.perform`.
    system : System
    experiment : Experiment
    mode : bool or str
        True, or one of `TRUST`.
    output, progress, pool, lacks
        As in `perform`.

    Returns
    -------
    Result
        Of the run itself. Its `trust` holds the bands, which are also columns of it unless a sink
        took the rows.

    Raises
    ------
    InvalidInput
        As `perform`, or an unknown mode.
    """
    if mode is not True and mode not in TRUST:
        raise InvalidInput(f"trust = {mode!r} is not valid; give true, {' or '.join(TRUST)}")
    given = output if output is not None else experiment.output or Output()
    outputs = (given,) if isinstance(given, Output) else tuple(given)
    if isinstance(experiment.given_coupling, ModelExchange):
        raise InvalidInput(
            f"error bars repeat a run with its communication steps halved, of which the coupling "
            f"'{ModelExchange.name}' has none; compare it with a run to a tenth of the tolerance"
        )
    with ExitStack() as stack:
        lender = pool if pool is not None else stack.enter_context(SlavePool())
        if not isinstance(experiment.given_coupling, Auto):
            return _with_bars(perform, system, experiment, mode, outputs, progress, lender, lacks)
        # Once, so that all runs have the same one.
        choice = chosen(system, experiment, pool)
        result = _with_bars(
            perform, system, choice.experiment, mode, outputs, progress, lender, choice.lacks
        )
        return choice.added_to(result)


def _with_bars(
    perform: Callable[..., Result],
    system: System,
    experiment: Experiment,
    mode: bool | str,
    outputs: Sequence[Output],
    progress: Callable[[float], None] | None,
    pool: SlavePool,
    lacks: Sequence[Lack],
) -> Result:
    """The run, made again, and its result with the bands."""
    first = outputs[0]
    rows, points = Memory(), At(None)
    # The communication points, unless they are the rows themselves, and rows that a sink takes.
    is_every_point = first == Output()
    further = [] if is_every_point else [Output(sink=points)]
    if first.sink is not None:
        further.append(replace(first, sink=rows))

    def run(experiment: Experiment, outputs: Sequence[Output], **more: Any) -> Result:
        return perform(system, experiment, output=outputs, pool=pool, lacks=lacks, **more)

    with closing(
        Ahead(system, experiment, first, _part(progress, 0.0, ONE_OF_THREE), lacks)
    ) as ahead:
        base = run(experiment, [*outputs, *further], progress=ahead.progress)
        reached = base.time if is_every_point else points.times()
        if not base.whole or len(reached) < 2:
            return replace(base, trust=Trust.unknown("the run did not come to its end"))
        if not base.names:
            return replace(base, trust=Trust.unknown("nothing is recorded"))
        table = np.column_stack([base.time, base.values]) if first.sink is None else rows.rows()
        again = Again(run, experiment, base.statistics, reached, table, first.interval, ahead.ended)
        resolved = system.resolve()
        trust = _judged(
            again,
            resolved.recorded(experiment.record),
            mode,
            _part(progress, ONE_OF_THREE, 1.0),
            discrete=bool(resolved.discrete_links),
        )
    if first.sink is not None or trust.bands is None:
        return replace(base, trust=trust)
    return replace(
        base,
        names=(*base.names, *map(error_name, base.names)),
        values=np.hstack([base.values, trust.bands]),
        trust=trust,
    )


def _part(
    progress: Callable[[float], None] | None, begin: float, end: float
) -> Callable[[float], None] | None:
    """Progress of a part of the work."""
    if progress is None:
        return None
    return lambda fraction: progress(begin + fraction * (end - begin))


def _judged(
    again: Again,
    recorded: Sequence[Recorded],
    mode: bool | str,
    progress: Callable[[float], None] | None,
    *,
    discrete: bool,
) -> Trust:
    """Make the run again, and say how far it may be off."""
    time, values, statistics = again.time, again.values, again.statistics
    second, finer = again.halved(progress)
    if not second.whole:
        return Trust.unknown(f"the second run: {second.message}", second.status.name)
    names = [item.name for item in recorded]
    signed = values - finer
    # Where an FMU ended the second run earlier, the last difference is the best that is known.
    missing = np.isnan(signed[:, 0])
    signed[missing] = signed[~missing][-1]
    peaks = np.maximum(np.abs(values).max(axis=0), np.fmax.reduce(np.abs(finer)))
    strange = np.flatnonzero(np.abs(signed[0]) > UNREPEATED * peaks)
    if strange.size:
        k = int(strange[0])
        return Trust.unknown(
            f"{names[k]} starts from {values[0, k]:.6g}, and from {finer[0, k]:.6g} when the run "
            "is made again: an FMU does not repeat what it does"
        )
    switched = np.array(
        [_is_switched(item, column) for item, column in zip(recorded, values.T, strict=True)], bool
    )
    # Of whatever order inputs are moved, a jump that nobody announces is late by part of a step.
    switches = bool(switched.any() or discrete)
    order: float | Floats = 1.0 if switches else float(statistics.order)
    notes: list[Note] = []
    if mode == "order":
        order, notes = observed(again, np.abs(signed), ~switched, FLOOR * peaks, names)
    sizes = peaks + [item.variable.nominal for item in recorded]
    found, differs = _widths(again, signed, switched, order, peaks, sizes, switches=switches)
    if mode == "probe":
        notes += probed(again, found, names)
    runs = 1.0 + again.steps / (statistics.macro_steps * (3.0 if statistics.parts > 1 else 1.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.nan_to_num(found.max(axis=0) / peaks, nan=0.0)
    relative[switched] = differs
    verdicts = tuple(map(_verdict, relative))
    worst = int(np.argmax(relative))
    passes = found > RESOLVED * peaks
    since = tuple(float(time[at.argmax()]) if at.any() else None for at in passes.T)
    error, least = float(relative[worst]), float(np.min(order))
    verdict = NOT_RESOLVED if any(note.settles for note in notes) else verdicts[worst]
    trust = Trust(verdict, "", error, found, relative, verdicts, since, least, runs)
    at = float(time[int(np.argmax(found[:, worst]))])
    return replace(trust, line=_line(trust, names, worst, at, bool(switched[worst]), notes))


def _is_switched(item: Recorded, values: Floats) -> bool:
    """Whether a recorded variable, values of shape (N,), jumps between few values."""
    if item.variable.type != "Real" or item.variable.variability == "discrete":
        return True
    # Most variables take many values among a few rows, and need no look at all of them.
    few = values[:: 1 + len(values) // (ROWS_PER_LEVEL * MOST_LEVELS)]
    if len(set(few.tolist())) > MOST_LEVELS:
        return False
    levels = len(set(values.tolist()))
    return 1 < levels <= MOST_LEVELS < len(values) / ROWS_PER_LEVEL


def _widths(
    again: Again,
    signed: Floats,
    switched: Mask,
    order: float | Floats,
    peaks: Floats,
    sizes: Floats,
    *,
    switches: bool,
) -> tuple[Floats, Floats]:
    """The bands, shape (N, M), from the difference of both runs; and the share of the rows in which
    switched variables differ, shape (number of them,).

    Parameters
    ----------
    again : Again
    signed : array, shape (N, M)
        The values less those of the second run.
    switched : array, shape (M,)
    order : float or array, shape (M,)
    peaks, sizes : arrays, shape (M,)
        The sizes are nominal values plus peaks.
    switches : bool
        Whether anything switches, recorded or not.
    """
    time, coupling = again.time, again.experiment.chosen_coupling
    powers = np.maximum(order, LEAST_ORDER)
    if isinstance(coupling, Derivative) or (
        isinstance(coupling, Hermite) and coupling.iterations == 1
    ):
        starting = time[:, None] <= again.points[: STARTING + 1][-1]
        powers = np.where(starting, np.minimum(powers, 1.0), powers)
    share = np.empty(0)
    if switches:
        # Both runs may be late alike: what a variable changes over a step counts as well.
        late = late_switches(time, again.points, again.values, switched)
        difference = np.maximum(np.abs(signed), late / 2.0)
        found = bands(time, difference, powers, peaks) * JITTER
        share = (difference[:, switched] > 0.0).mean(axis=0)
    else:
        every_step = again.statistics.parts == 1 and np.array_equal(time, again.points)
        found = bands(time, signed, powers, peaks, every_step=every_step)
    floor = max(FLOOR, SLAVE_FLOOR * (slave_tolerance(again.experiment) or 0.0)) * peaks
    if again.statistics.looks_ahead:
        # What a jump may leave by coming late; both runs may make it at the same time.
        floor = np.maximum(floor, KINKED * (again.experiment.tolerance or 0.0) * sizes)
    found = np.maximum(found, floor)
    if not switches:
        with np.errstate(divide="ignore", invalid="ignore"):
            largest = np.fmax.reduce(np.abs(signed.T) / peaks[:, None])
        shares = amplified(time, largest)
        found[shares] = np.maximum(found[shares], np.minimum(SHARED * found[shares], LOST * peaks))
    # What is not resolved stays so: in chaos, a small difference later on is chance.
    lost = np.logical_or.accumulate(found > ROUGH * peaks)
    if lost.any():
        found = np.where(lost, np.maximum.accumulate(found), found)
    if switched.any():
        found[:, switched] = window_maxima(time, difference[:, switched])
    return found, share


def _verdict(relative: float) -> str:
    if relative <= RESOLVED:
        return "resolved"
    return "rough" if relative <= ROUGH else NOT_RESOLVED


def _line(
    trust: Trust,
    names: Sequence[str],
    worst: int,
    at: float,
    switched: bool,
    notes: Sequence[Note],
) -> str:
    """What there is to say, in one line; the band of the worst variable is widest `at` a time."""
    error = trust.relative[worst]
    if switched:
        said = f"{names[worst]} switches at other times: {error:.2g} of the time it differs"
    elif trust.verdict == NOT_RESOLVED:
        since = trust.since[worst]
        others = sum(v == NOT_RESOLVED for v in trust.verdicts) - 1
        said = f"not resolved: {names[worst]} may be off by {_percent(error)} of its peak"
        if since is not None:
            said += f", by a tenth of it from t = {since:.4g} s on"
        if others > 0:
            said += f" (and {others} more)"
    else:
        said = f"within {_percent(error)} of each peak (worst {names[worst]} at t = {at:.4g} s)"
        if trust.verdict != "resolved":
            said = f"{trust.verdict}: {said}"
    parts = [said, f"order {trust.order:.2g}", f"{trust.runs:.1f} runs", *(n.text for n in notes)]
    return f"trust: {'; '.join([*parts, INSIDE])}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 10.0 else f"{share:.2g} times"
