"""What further runs say about error bars: the order that is observed, and steps inside FMUs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from congelation.cosim.rerun import Again, divided

__all__ = ["Note", "observed", "probed"]

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

PROBED, FINER = 0.01, 32
"""Of the horizon, the part that the probe makes again, and how many steps it makes of each."""

SEEN = 2.0
"""The probe sees an inner step where it is off by so many bands."""


class Note(NamedTuple):
    """What a further run has shown.

    Parameters
    ----------
    text : str
    settles : bool
        Whether it makes bands meaningless.
    """

    text: str
    settles: bool


def observed(
    again: Again, difference: Floats, smooth: Mask, floor: Floats, names: Sequence[str]
) -> tuple[Floats, list[Note]]:
    """The order of each variable, shape (M,), from a run with doubled steps; and what it says.

    Parameters
    ----------
    again : Again
    difference : array, shape (N, M)
        To the run with halved steps.
    smooth : array, shape (M,)
        Variables that do not switch.
    floor : array, shape (M,)
        Differences that mean nothing.
    names : sequence of str, length M
    """
    expected = again.statistics.order
    order = np.full(len(names), float(expected))
    count = (len(again.points) - 1) // 2 * 2
    points = divided(again.points[: count + 1 : 2], again.statistics.parts)
    third, coarse = again.at(points)
    if not third.whole:
        return order, [Note(f"with doubled steps: {third.message}", False)]
    here = ~np.isnan(coarse).any(axis=1)
    change = np.abs(coarse[here] - again.values[here]).max(axis=0)
    before = difference[here].max(axis=0)
    observable = smooth & (np.minimum(change, before) > floor)
    order[observable] = np.minimum(np.log2(change[observable] / before[observable]), expected)
    notes = []
    if observable.any():
        k = int(np.argmin(np.where(observable, order, np.inf)))
        if order[k] < 0.0:
            notes.append(
                Note(
                    f"{names[k]} gets worse as steps shrink: a loop gain above 1 with held inputs?",
                    True,
                )
            )
        elif order[k] < expected / 2.0:
            notes.append(
                Note(
                    f"{names[k]} is not smooth (order {order[k]:.1f} in place of {expected}): a "
                    "jump that no FMU announces?",
                    False,
                )
            )
    return order, notes


def probed(again: Again, found: Floats, names: Sequence[str]) -> list[Note]:
    """What far shorter steps at the beginning say against the bands, shape (N, M), of variables of
    these names."""
    start, stop = again.points[0], again.points[-1]
    until = max(start + PROBED * (stop - start), again.time[1])
    count = max(int(np.searchsorted(again.points, until, "right")), 2)
    fine, values = again.at(divided(again.points[:count], FINER * again.statistics.parts))
    if not fine.whole:
        return [Note(f"probe: {fine.message}", False)]
    here = ~np.isnan(values).any(axis=1)
    off = (
        np.abs(values[here] - again.values[here]) / np.where(found[here] > 0, found[here], np.inf)
    ).max(axis=0)
    k = int(np.argmax(off))
    if off[k] <= SEEN:
        return [Note("probe: no inner step of an FMU seen", False)]
    return [
        Note(
            f"probe: with steps {FINER} times shorter {names[k]} differs by {off[k]:.2g} bands: an "
            "FMU steps inside on a grid of its own, whose error no band holds",
            True,
        )
    ]
