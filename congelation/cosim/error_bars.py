"""Error bars: a run is made again with every step halved, and the difference becomes bands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from congelation.cosim.bands import bands, error_name, window_maxima
from congelation.cosim.choice import Lack, chosen
from congelation.cosim.coupling import Auto, Derivative, Hermite, ModelExchange
from congelation.cosim.experiment import Experiment, slave_tolerance
from congelation.cosim.pool import SlavePool
from congelation.cosim.recording import Output
from congelation.cosim.rerun import Again, Ahead, At, divided
from congelation.cosim.result import Result, Trust
from congelation.cosim.sinks import Memory
from congelation.cosim.system import Recorded, System
from congelation.errors import InvalidInput

__all__ = ["TRUST", "trusted"]

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

TRUST = ("order", "probe")
"""What may be asked for besides the bands."""

STARTING = 4
"""Intervals after the start in which extrapolation by derivatives that come from history is of
order 1. (`hermite` makes ends agree by iterations, so it has its order from the start.)"""

JITTER = 1.3
"""What a band is wider where something switches: delays of up to a step add up at random."""

FLOOR = 1e-8
"""Of a variable's peak: no band is narrower, as rounding and unfinished iterations count, too."""

SLAVE_FLOOR = 0.1
"""The same of the tolerance of the FMUs: theirs in the second run is a hundredth."""

RESOLVED, ROUGH = 0.1, 0.3
"""Largest band over peak up to which a variable counts as resolved, and as rough."""


MOST_LEVELS = 8
"""A variable that takes at most so many values, in many more rows, is a switched one."""


PROBED, FINER = 0.01, 32
"""Of the horizon, the part that the probe makes again, and how many steps it makes of each."""

UNREPEATED = 1e-5
"""Of a variable's peak: two runs that start further apart are no repetition."""

LEAST_ORDER = 0.5
"""Where a lower one is observed, differences say nothing of errors any more."""

ROWS_PER_LEVEL = 8
"""A switched variable has so many rows for each value it may take."""

SEEN = 2.0
"""The probe sees an inner step where it is off by so many bands."""


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
    if isinstance(experiment.given_coupling, ModelExchange):
        raise InvalidInput(
            f"error bars repeat a run with its communication steps halved, of which the coupling "
            f"'{ModelExchange.name}' has none; compare it with a run to a tenth of the tolerance"
        )
    if isinstance(experiment.given_coupling, Auto):
        # Once, so that all runs have the same one.
        choice = chosen(system, experiment, pool)
        return choice.added_to(
            trusted(
                perform,
                system,
                choice.experiment,
                mode,
                output=given,
                progress=progress,
                pool=pool,
                lacks=choice.lacks,
            )
        )
    first, *others = (given,) if isinstance(given, Output) else given
    rows, points = Memory(), At(None)
    outputs = [first, *others]
    # The communication points, unless they are the rows themselves, and rows that a sink takes.
    is_every_point = first == Output()
    if not is_every_point:
        outputs.append(Output(sink=points))
    if first.sink is not None:
        outputs.append(replace(first, sink=rows))
    with ExitStack() as stack:
        lender = pool if pool is not None else stack.enter_context(SlavePool())

        def run(experiment: Experiment, outputs: Sequence[Output], **more: Any) -> Result:
            return perform(system, experiment, output=outputs, pool=lender, lacks=lacks, **more)

        ahead = stack.enter_context(
            closing(Ahead(system, experiment, first, _part(progress, 0.0, ONE_OF_THREE), lacks))
        )
        base = run(experiment, outputs, progress=ahead.progress)
        reached = base.time if is_every_point else points.times()
        if not base.whole or len(reached) < 2:
            return replace(base, trust=Trust.unknown("the run did not come to its end"))
        if not base.names:
            return replace(base, trust=Trust.unknown("nothing is recorded"))
        table = np.column_stack([base.time, base.values]) if first.sink is None else rows.rows()
        again = Again(run, experiment, base.statistics, reached, table, first.interval, ahead)
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


ONE_OF_THREE = 1.0 / 3.0
"""The run's part of the work."""


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
    peaks = np.maximum(np.abs(values).max(axis=0), np.nanmax(np.abs(finer), axis=0))
    signed = values - finer
    # Where an FMU ended the second run earlier, the last difference is the best that is known.
    missing = np.isnan(signed[:, :1]).all(axis=1)
    signed[missing] = signed[~missing][-1]
    difference = np.abs(signed)
    strange = np.flatnonzero(difference[0] > UNREPEATED * peaks)
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
    notes: list[_Note] = []
    if mode == "order":
        order, notes = _observed(again, difference, ~switched, peaks, names)
    found, difference = _widths(again, signed, switched, order, peaks, switches=switches)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.nan_to_num(found.max(axis=0) / peaks, nan=0.0)
    relative[switched] = (difference[:, switched] > 0.0).mean(axis=0)
    if mode == "probe":
        notes += _probed(again, found, names)
    verdicts = tuple(map(_verdict, relative))
    since = tuple(
        float(time[np.argmax(column > RESOLVED * peak)])
        if (column > RESOLVED * peak).any()
        else None
        for column, peak in zip(found.T, peaks, strict=True)
    )
    runs = 1.0 + again.steps / (statistics.macro_steps * (3.0 if statistics.parts > 1 else 1.0))
    blank = Trust("resolved", "", 0.0, found, relative, verdicts, since, float(np.min(order)), runs)
    worst = int(np.argmax(relative))
    error = float(relative[worst])
    at = float(time[int(np.argmax(found[:, worst]))])
    verdict = NOT_RESOLVED if any(note.settles for note in notes) else verdicts[worst]
    return replace(
        blank,
        verdict=verdict,
        error=error,
        line=_line(blank, verdict, names, worst, at, bool(switched[worst]), notes),
    )


def _widths(
    again: Again,
    signed: Floats,
    switched: Mask,
    order: float | Floats,
    peaks: Floats,
    *,
    switches: bool,
) -> tuple[Floats, Floats]:
    """The bands, shape (N, M), from the difference of both runs; and its size that counts, in which
    switches of both runs that are late alike are included.

    Parameters
    ----------
    again : Again
    signed : array, shape (N, M)
        The values less those of the second run.
    switched : array, shape (M,)
    order : float or array, shape (M,)
    peaks : array, shape (M,)
    switches : bool
        Whether anything switches, recorded or not.
    """
    time, statistics, difference = again.time, again.statistics, np.abs(signed)
    if switches:
        # Both runs may be late alike: what a variable changes over a step counts as well.
        difference = np.maximum(difference, _by_late_switches(again, switched) / 2.0)
    floor = max(FLOOR, SLAVE_FLOOR * (slave_tolerance(again.experiment) or 0.0)) * peaks
    powers = np.full(difference.shape, np.maximum(order, LEAST_ORDER))
    coupling = again.experiment.chosen_coupling
    if isinstance(coupling, Derivative) or (
        isinstance(coupling, Hermite) and coupling.iterations == 1
    ):
        begun = time <= again.points[: STARTING + 1][-1]
        powers[begun] = np.minimum(powers[begun], 1.0)
    if switches:
        found = bands(time, difference, powers, peaks) * JITTER
    else:
        whole = statistics.parts == 1 and np.array_equal(time, again.points)
        found = bands(time, signed, powers, peaks, every_step=whole)
    found = np.maximum(found, floor)
    # What is not resolved stays so: in chaos, a small difference later on is chance.
    lost = np.logical_or.accumulate(found > ROUGH * peaks)
    found = np.where(lost, np.maximum.accumulate(found), found)
    found[:, switched] = window_maxima(time, difference[:, switched])
    return found, difference


class _Note(NamedTuple):
    """What a further run has shown.

    Parameters
    ----------
    text : str
    settles : bool
        Whether it makes bands meaningless.
    """

    text: str
    settles: bool


NOT_RESOLVED = "not resolved"


def _verdict(relative: float) -> str:
    if relative <= RESOLVED:
        return "resolved"
    return "rough" if relative <= ROUGH else NOT_RESOLVED


def _line(
    trust: Trust,
    verdict: str,
    names: Sequence[str],
    worst: int,
    at: float,
    switched: bool,
    notes: Sequence[_Note],
) -> str:
    """What there is to say, in one line."""
    error = trust.relative[worst]
    if switched:
        said = f"{names[worst]} switches at other times: {error:.2g} of the time it differs"
    elif verdict == NOT_RESOLVED:
        since = trust.since[worst]
        others = sum(v == NOT_RESOLVED for v in trust.verdicts) - 1
        said = f"not resolved: {names[worst]} may be off by {_percent(error)} of its peak"
        if since is not None:
            said += f", by a tenth of it from t = {since:.4g} s on"
        if others > 0:
            said += f" (and {others} more)"
    else:
        said = f"within {_percent(error)} of each peak (worst {names[worst]} at t = {at:.4g} s)"
        if verdict != "resolved":
            said = f"{verdict}: {said}"
    parts = [said, f"order {trust.order:.2g}", f"{trust.runs:.1f} runs", *(n.text for n in notes)]
    return f"trust: {'; '.join([*parts, INSIDE])}"


INSIDE = "errors inside an FMU count only as far as they change with the step"


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 10.0 else f"{share:.2g} times"


def _by_late_switches(again: Again, switched: Mask) -> Floats:
    """By how much the values differ from those one communication step earlier, shape (N, M).

    Of variables that are not switched, the largest so far, of the rows at which a switched one
    changes: shorter steps later on do not undo that it was late. Where only what is not recorded
    switches, every row may be such a row.
    """
    k = np.searchsorted(again.points, again.time).clip(1, len(again.points) - 1)
    before = again.time - np.diff(again.points)[k - 1]
    earlier = [np.interp(before, again.time, column) for column in again.values.T]
    change: Floats = np.abs(again.values - np.column_stack(earlier))
    if switched.any():
        changes = (np.diff(again.values[:, switched], axis=0) != 0.0).any(axis=1)
        # It may have been due in the step before or after as well.
        near = np.convolve(changes, np.ones(3), "full")[: len(change)] > 0.0
        smooth = np.where(near[:, None], change, 0.0)[:, ~switched]
        change[:, ~switched] = np.maximum.accumulate(smooth)
    return change


def _is_switched(item: Recorded, values: Floats) -> bool:
    """Whether a recorded variable, values of shape (N,), jumps between few values."""
    if item.variable.type != "Real" or item.variable.variability == "discrete":
        return True
    # Most variables take many values among a few rows, and need no look at all of them.
    few = values[:: 1 + len(values) // (ROWS_PER_LEVEL * MOST_LEVELS)]
    if len(np.unique(few)) > MOST_LEVELS:
        return False
    levels = len(np.unique(values))
    return 1 < levels <= MOST_LEVELS < len(values) / ROWS_PER_LEVEL


def _observed(
    again: Again, difference: Floats, smooth: Mask, peaks: Floats, names: Sequence[str]
) -> tuple[Floats, list[_Note]]:
    """The order of each variable, shape (M,), from a run with doubled steps; what it says."""
    expected = again.statistics.order
    order = np.full(len(names), float(expected))
    count = (len(again.points) - 1) // 2 * 2
    points = divided(again.points[: count + 1 : 2], again.statistics.parts)
    third, coarse = again.at(points)
    if not third.whole:
        return order, [_Note(f"with doubled steps: {third.message}", False)]
    here = ~np.isnan(coarse).any(axis=1)
    change = np.abs(coarse[here] - again.values[here]).max(axis=0)
    before = difference[here].max(axis=0)
    told = smooth & (np.minimum(change, before) > FLOOR * peaks)
    order[told] = np.minimum(np.log2(change[told] / before[told]), expected)
    notes = []
    if told.any():
        k = int(np.argmin(np.where(told, order, np.inf)))
        if order[k] < 0.0:
            notes.append(
                _Note(
                    f"{names[k]} gets worse as steps shrink: a loop gain above 1 with held inputs?",
                    True,
                )
            )
        elif order[k] < expected / 2.0:
            notes.append(
                _Note(
                    f"{names[k]} is not smooth (order {order[k]:.1f} in place of {expected}): a "
                    "jump that no FMU announces?",
                    False,
                )
            )
    return order, notes


def _probed(again: Again, found: Floats, names: Sequence[str]) -> list[_Note]:
    """What far shorter steps at the beginning say against the bands, shape (N, M)."""
    start, stop = again.points[0], again.points[-1]
    until = max(start + PROBED * (stop - start), again.time[1])
    count = max(int(np.searchsorted(again.points, until, "right")), 2)
    fine, values = again.at(divided(again.points[:count], FINER * again.statistics.parts))
    if not fine.whole:
        return [_Note(f"probe: {fine.message}", False)]
    here = ~np.isnan(values).any(axis=1)
    off = (
        np.abs(values[here] - again.values[here]) / np.where(found[here] > 0, found[here], np.inf)
    ).max(axis=0)
    k = int(np.argmax(off))
    if off[k] <= SEEN:
        return [_Note("probe: no inner step of an FMU seen", False)]
    return [
        _Note(
            f"probe: with steps {FINER} times shorter {names[k]} differs by {off[k]:.2g} bands: an "
            "FMU steps inside on a grid of its own, whose error no band holds",
            True,
        )
    ]
