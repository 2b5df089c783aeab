"""Bands around the values of a run, from its difference to a run with half the step.

The difference of two runs whose errors are c h^p and c (h / 2)^p is (2^p - 1) / 2^p of the error of
the first one (Richardson; Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I,
section II.4). It passes through zero where the error does not, as when an oscillation lags: a band
is therefore laid over its maxima.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["MARGIN", "bands", "error_name", "variable_of", "window_maxima"]

Floats = npt.NDArray[np.float64]

WINDOW = 0.01
"""Of the horizon, to either side: so far the largest difference counts."""

MARGIN = 1.5
"""What a band is wider than the error that the difference suggests."""

NEAR_PEAK, AT_PEAK = 0.5, 1.2
"""From this share of the peak on, a difference counts less and less as an extrapolation has it; at
the peak, it is the error but for this factor."""


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
    factor = np.broadcast_to(2.0**order / (2.0**order - 1.0), difference.shape)
    if peaks is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            size = np.nan_to_num(np.abs(difference) / peaks, nan=0.0)
        large = np.clip((size - NEAR_PEAK) / (1.0 - NEAR_PEAK), 0.0, 1.0)
        factor = factor + large * (np.minimum(factor, AT_PEAK) - factor)
    error = np.abs(difference) * factor
    if every_step and len(difference) > 2:
        before, here, after = difference[:-2], difference[1:-1], difference[2:]
        alternating = (2.0 * here - before - after) / 4.0
        smooth = (2.0 * here + before + after) / 4.0
        apart = np.abs(smooth) * factor[1:-1] + np.abs(alternating)
        error[1:-1] = np.minimum(error[1:-1], np.maximum(apart, np.abs(here)))
    highest = window_maxima(time, error)
    return MARGIN * np.column_stack(
        [np.maximum(column, _over_maxima(time, column)) for column in highest.T]
    )


def window_maxima(time: Floats, values: Floats) -> Floats:
    """The largest of values, shape (N, M), within the window around each time."""
    # A little wider, so that a row at its very end counts wherever times are rounded to.
    width = (1.0 + 1e-6) * WINDOW * (time[-1] - time[0])
    first = np.searchsorted(time, time - width, "left")
    after = np.searchsorted(time, time + width, "right")
    # Maxima over 2^k rows from each row on; two of them cover any number of rows.
    level, found, length = 0, np.zeros_like(values), after - first
    table = values
    while True:
        here = (length >= 2**level) & (length < 2 ** (level + 1))
        found[here] = np.maximum(table[first[here]], table[after[here] - 2**level])
        if 2 ** (level + 1) > length.max():
            return found
        table = np.maximum(table[: -(2**level)], table[2**level :])
        level += 1


def _over_maxima(time: Floats, values: Floats) -> Floats:
    """The lines through the local maxima of values, shape (N,), and through both ends."""
    rises, falls = np.ones(len(values), bool), np.ones(len(values), bool)
    rises[1:], falls[:-1] = values[1:] >= values[:-1], values[:-1] >= values[1:]
    highest = rises & falls
    highest[[0, -1]] = True
    places = np.flatnonzero(highest)
    return np.interp(time, time[places], values[places])
