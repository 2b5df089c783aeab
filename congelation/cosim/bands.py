"""Bands around the values of a run, from its difference to a run with half the step.

The difference of two runs whose errors are c h^p and c (h / 2)^p is (2^p - 1) / 2^p of the error of
the first one (Richardson; Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I,
section II.4). It passes through zero where the error does not, as when an oscillation lags: a band
is therefore laid over its maxima.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = [
    "FLOOR",
    "MARGIN",
    "amplified",
    "bands",
    "error_name",
    "late_switches",
    "variable_of",
    "window_maxima",
]

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

FLOOR = 1e-8
"""Of a variable's peak: no band is narrower, as rounding and unfinished iterations count, too."""

WINDOW = 0.01
"""Of the horizon, to either side: so far the largest difference counts."""

MARGIN = 1.5
"""What a band is wider than the error that the difference suggests."""

NEAR_PEAK, AT_PEAK = 0.5, 1.2
"""From this share of the peak on, a difference counts less and less as an extrapolation has it; at
the peak, it is the error but for this factor."""

GROWN = 40.0
"""By so much a difference has grown since half of the time, where a system amplifies errors. Where
they add up it grows by 2 or 4; where spikes shift, by up to 37 in the second half of all coupling
problems but one, and by 69 and more in Lorenz."""


def error_name(variable: str) -> str:
    """The column of a variable's band."""
    return f"error({variable})"


def variable_of(column: str) -> str:
    """The variable that a column is of: itself, or that of the band."""
    name = column.removeprefix("error(")
    return column if name == column else name.removesuffix(")")


def bands(
    time: Floats,
    difference: Floats,
    order: float | Floats,
    peaks: Floats | None = None,
    *,
    every_step: bool = False,
) -> Floats:
    """Bands around the values of a run.

    Parameters
    ----------
    time : array, shape (N,)
        Increasing.
    difference : array, shape (N, M)
        To the values of a run with half the step.
    order : float or array, of a shape that extends to (N, M)
        Power p of the step with which the error falls.
    every_step : bool
        Whether the rows are the communication points, all of them, and the difference has its sign.
        An error that changes its sign from step to step, as in an algebraic loop with held inputs,
        is not half as large in the other run, which has made twice as many steps by then: that part
        of the difference is all of it.
    peaks : array, shape (M,), optional
        Of the variables. A difference near the peak is most of the error, as values stay bounded.

    Returns
    -------
    array, shape (N, M)
        Largest error suggested by the difference within `WINDOW` of the horizon, and where that is
        less, lines through its local maxima; times `MARGIN`.
    """
    windows = _Windows(time)
    factors = np.broadcast_to(2.0**order / (2.0**order - 1.0), difference.shape)
    # Column by column, as hundreds of thousands of rows of one fit into a cache.
    found = np.empty(difference.shape[::-1])
    for k, column in enumerate(np.ascontiguousarray(difference.T)):
        peak = None if peaks is None else float(peaks[k])
        error = _error(column, factors[:, k], peak, every_step=every_step)
        highest = windows.maxima(error)
        found[k] = MARGIN * np.maximum(highest, _over_maxima(time, highest))
    return found.T


def _error(difference: Floats, factor: Floats, peak: float | None, *, every_step: bool) -> Floats:
    """The error that a difference suggests at each row, shapes (N,)."""
    size = np.abs(difference)
    if peak and size.max(initial=0.0) > NEAR_PEAK * peak:
        large = np.clip((size / peak - NEAR_PEAK) / (1.0 - NEAR_PEAK), 0.0, 1.0)
        factor = factor + large * (np.minimum(factor, AT_PEAK) - factor)
    error = size * factor
    if every_step and len(difference) > 2:
        before, here, after = difference[:-2], difference[1:-1], difference[2:]
        alternating = (2.0 * here - before - after) / 4.0
        smooth = (2.0 * here + before + after) / 4.0
        apart = np.abs(smooth) * factor[1:-1] + np.abs(alternating)
        error[1:-1] = np.minimum(error[1:-1], np.maximum(apart, np.abs(here)))
    return error


def window_maxima(time: Floats, values: Floats) -> Floats:
    """The largest of values, shape (N, M), within the window around each time."""
    windows = _Windows(time)
    found = [windows.maxima(column) for column in np.ascontiguousarray(values.T)]
    return np.array(found).reshape(values.shape[::-1]).T


class _Windows:
    """The rows within the window around each row.

    Parameters
    ----------
    time : array, shape (N,)
    """

    def __init__(self, time: Floats) -> None:
        # A little wider, so that a row at its very end counts wherever times are rounded to.
        width = (1.0 + 1e-6) * WINDOW * (time[-1] - time[0])
        first = np.searchsorted(time, time - width, "left")
        after = np.searchsorted(time, time + width, "right")
        # Two spans of 2^level rows cover any number of rows below 2^(level + 1).
        levels = np.frexp(after - first)[1] - 1
        self._spans = []
        for level in range(int(levels.max()) + 1):
            rows = np.flatnonzero(levels == level)
            self._spans.append((rows, first[rows], after[rows] - 2**level))

    def maxima(self, values: Floats) -> Floats:
        """The largest of values, shape (N,), around each row."""
        found, table = np.empty_like(values), values  # of 2^level rows from each row on
        for level, (rows, first, last) in enumerate(self._spans):
            if level:
                table = np.maximum(table[: -(2 ** (level - 1))], table[2 ** (level - 1) :])
            found[rows] = np.maximum(table[first], table[last])
        return found


def _over_maxima(time: Floats, values: Floats) -> Floats:
    """The lines through the local maxima of values, shape (N,), and through both ends."""
    rises, falls = np.ones(len(values), bool), np.ones(len(values), bool)
    rises[1:], falls[:-1] = values[1:] >= values[:-1], values[:-1] >= values[1:]
    highest = rises & falls
    highest[[0, -1]] = True
    places = np.flatnonzero(highest)
    return np.interp(time, time[places], values[places])


def amplified(time: Floats, difference: Floats) -> Mask:
    """From when on a run has amplified its early errors, shape (N,).

    What two runs are apart is then that part of their early errors which grows. It is one number of
    each, and by chance these may be nearly the same, so that the difference stays small long after
    the error has become large. Only the second half of a run counts: what grows earlier has time to
    become as large as the values.

    Parameters
    ----------
    time : array, shape (N,)
        Increasing.
    difference : array, shape (N,)
        Of both runs, the largest of all variables, each over its peak.
    """
    since = time - time[0]
    before = np.interp(since / 2.0, since, np.maximum.accumulate(difference))
    here = _Windows(time).maxima(difference)
    late = since >= since[-1] / 2.0
    grown: Mask = late & (before > FLOOR) & (here > GROWN * before)
    return np.logical_or.accumulate(grown)


def late_switches(time: Floats, points: Floats, values: Floats, switched: Mask) -> Floats:
    """By how much values differ from those one communication step earlier, shape (N, M).

    Of variables that are not switched, the largest so far, of the rows at which a switched one
    changes: shorter steps later on do not undo that it was late. Where only what is not recorded
    switches, every row may be such a row.

    Parameters
    ----------
    time : array, shape (N,)
    points : array, shape (P,)
        Communication points, the start time among them.
    values : array, shape (N, M)
    switched : array, shape (M,)
        Whether a variable switches.
    """
    k = np.searchsorted(points, time).clip(1, len(points) - 1)
    before = time - np.diff(points)[k - 1]
    earlier = [np.interp(before, time, column) for column in values.T]
    change: Floats = np.abs(values - np.column_stack(earlier))
    if switched.any():
        changes = (np.diff(values[:, switched], axis=0) != 0.0).any(axis=1)
        # It may have been due in the step before or after as well.
        near = np.convolve(changes, np.ones(3), "full")[: len(change)] > 0.0
        smooth = np.where(near[:, None], change, 0.0)[:, ~switched]
        change[:, ~switched] = np.maximum.accumulate(smooth)
    return change
