"""The polynomials that inputs follow over a step: extrapolated ahead of it, their order chosen,
their error estimated afterwards."""

from __future__ import annotations

from math import log
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.points import LinkReader, Points
from congelation.cosim.coupling.polynomial import hermite, matched

__all__ = ["HIGH", "LOW", "Piece", "estimated_error", "opened", "order_of_longer_step"]

Floats = npt.NDArray[np.float64]

LOW, HIGH = 4, 6
"""Orders: of the Hermite cubic, and of the cubic that acts like a quintic."""

RESIDUE = 16.0 / 3150.0
"""What is left of the Hermite cubic's distance f''''/24 h^4/16 where its first two moments are
mended: the second moment is f''''/24 h^7/1575, half of which, times the square of a rate of the
slave, is an error of its states. Over the step, for a slave whose rates are 1/h."""


UNEXPLAINED = 2.0
"""By so much a value changes more than its larger derivative at the two ends has it where it jumps
in between. A smooth value that is resolved changes by hardly more than that derivative has it."""


class Piece(NamedTuple):
    """The polynomials of all links over one step.

    Parameters
    ----------
    matrix : array, shape (4, 4) or (4, 6)
        Its product with `data` is C, the coefficients at the start of the step.
    data : array, shape (4, L) or (6, L)
        v0, d0 at the start of the step and v1, d1 at its end, which the iterations of a step
        improve in place; then value and derivative at a point before, where one is used.
    predicted : array, shape (2, L)
        Extrapolated value and derivative at the end.
    before : list of int
        The points that were extrapolated from, besides the start; see Points.before.
    """

    matrix: Floats
    data: Floats
    predicted: Floats
    before: list[int]


def opened(points: Points, end: float, order: int, reader: LinkReader) -> Piece:
    """The polynomials with which a step to `end` begins.

    Order 4 is the Hermite cubic. Order 6 takes the point before the step as well; it is a
    two-step formula and, as such, stable only while the step is not much longer than the loop's
    shortest time constant.
    """
    h = end - points.times[-1]
    before = points.before(end)
    predicted = points.extrapolated(end, before)
    high = bool(before) and order == HIGH
    data = np.empty((6 if high else 4, points.table.shape[2]))
    data[:2] = points.now
    data[2:4] = predicted
    if reader.inexact.size:
        data[1, reader.inexact] = points.predicted(points.times[-1], reader.inexact)[1]
        data[2:4, reader.inexact] = points.predicted(end, reader.inexact)
    if high:
        data[4:] = points.at(before[0])
        return Piece(matched(h, points.distance(before[0])), data, predicted, before)
    return Piece(hermite(h), data, predicted, before)


def estimated_error(
    piece: Piece, points: Points, end: float, new: Floats, *, high: bool, jumps: bool
) -> tuple[Floats, Floats | None]:
    """Estimated distances, shape (L,), of the links' polynomials from their values over a step.

    Parameters
    ----------
    piece : Piece
    points : Points
        At the start of the step and before.
    end : float
    new : array, shape (2, L)
        Values and derivatives at the end.
    high : bool
        Whether that of order 6 is wanted.
    jumps : bool
        Whether a value that changes more than its derivatives explain counts as a jump, which no
        polynomial follows. Estimated as if it were smooth, it may pass as accurate: f'''' times
        h^4 / 384 is 1/64 of a jump where steps are even, and less after a shorter one.

    Returns
    -------
    low, high : arrays, shape (L,)
        Of the Hermite cubic; of the matched cubic, or None where there are too few points.
    """
    h = end - points.times[-1]
    w, predicted, before = piece.data, piece.predicted, piece.before
    if not before:
        # The cubic's own third-order term, for want of a point before: it is the error of the
        # quadratic through v0, d0, v1.
        cubic = 2.0 * (w[0] - new[0]) + h * (w[1] + new[1])
        return np.abs(cubic) * (4.0 / 27.0), None

    # The Hermite cubic is off by f''''/24 s^2 (h - s)^2, at most f''''/24 (h/2)^4. The cubic
    # through the start and a point g before, extrapolated to the end, misses by
    # f''''/24 h^2 (h + g)^2, which gives f''''; its derivative gives the same fourth divided
    # difference.
    g = points.distance(before[0])
    hg = h + g
    expected = predicted if len(before) == 1 else points.extrapolated(end, before[:1])
    value, slope = np.abs(new - expected)
    low: Floats = np.maximum(
        value * (h * h / (16.0 * (hg * hg))), slope * (h * h * h / (32.0 * hg * (h + h + g)))
    )
    if jumps:
        change = np.abs(new[0] - w[0])
        explained = h * np.maximum(np.abs(w[1]), np.abs(new[1]))
        jumped = np.where(change > UNEXPLAINED * explained, change / 2.0, 0.0)
        low = np.maximum(low, jumped)
    if not high or len(before) < 2:
        return low, None

    # The quintic is off by f^(6)/720 s^2 (h - s)^2 (s + g)^2, taken at h/2. The quintic through
    # the start and points g and k before misses the end by f^(6)/720 h^2 (h + g)^2 (h + k)^2.
    k = points.distance(before[1])
    value, slope = np.abs(new - predicted)
    top, bottom = h * (h / 2.0 + g), hg * (h + k)
    share = top * top / (16.0 * (bottom * bottom))
    per_slope = 2.0 * (1.0 / h + 1.0 / hg + 1.0 / (h + k))
    quintic = np.maximum(value * share, slope * (share / per_slope))
    quintic = np.maximum(quintic, RESIDUE * low)
    return low, np.maximum(quintic, jumped) if jumps else quintic


def order_of_longer_step(low: float, high: float) -> int:
    """The order whose scaled error (1 is the tolerance) allows the longer next step.

    An instability of order 6 shows in its error first, so that it is left in time.
    """
    # By logarithms, as powers might overflow; an error of zero allows any step.
    return HIGH if high == 0.0 or (low > 0.0 and LOW * log(high) < HIGH * log(low)) else LOW
