"""The recorded variables of an ensemble, found in its buffers, from which rows are filled."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from congelation.cosim.buffers import NO_DERIVATIVE
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.system import Recorded

__all__ = ["Columns"]

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


class Columns:
    """The recorded variables of an ensemble, found in its buffers.

    Parameters
    ----------
    ensemble : Ensemble
    recorded : sequence of Recorded, length M
    latched : bool
        Whether driven inputs keep the values in C between communication points, rather than
        those of their sources.

    Attributes
    ----------
    smooth, slopes : integer arrays, shape (K,)
        The columns whose derivatives are read, and where those stand in Y.
    stepped : integer array
        The columns that change at events alone: no Reals, and Reals that are not continuous.
    sampled : integer array, shape (S,)
        Where the Real values stand in Y that are known at communication points alone, being without
        derivatives, or that nothing but these columns sees.
    nominal : array, shape (S,)
        Their nominal values.
    """

    def __init__(self, ensemble: Ensemble, recorded: Sequence[Recorded], *, latched: bool) -> None:
        self.ensemble = ensemble
        self.width = len(recorded)
        links = {(link.target, link.input.name): k for k, link in enumerate(ensemble.links)}
        places, slopes = [], []
        self.stepped: Indices = np.array(
            [column for column, item in enumerate(recorded) if item.variable.is_held],
            np.intp,
        )
        self._latched: list[tuple[int, int]] = []
        self._converted: list[tuple[int, float, float]] = []
        self._slow: list[tuple[int, Recorded]] = []
        for column, item in enumerate(recorded):
            link = links.get((item.member, item.variable.name))
            slope = NO_DERIVATIVE
            if item.variable.type != "Real":
                self._slow.append((column, item))
                places.append(0)
            elif link is not None and latched:
                self._latched.append((column, link))
                places.append(0)
            elif link is not None:
                # At a communication point a driven input has the value of its source.
                places.append(int(ensemble.source[link]))
                source = ensemble.links[link]
                if not source.converts:  # else the derivative is in the units of the output
                    slope = ensemble.slope_place(source.source, source.output.name)
            else:
                places.append(ensemble.place(item.member, item.variable.name))
                slope = ensemble.slope_place(item.member, item.variable.name)
            if link is not None and ensemble.links[link].converts:
                units = ensemble.links[link]
                self._converted.append((column, units.factor, units.offset))
            slopes.append(slope)
        self._places = np.array(places, np.intp)
        every = np.array(slopes, np.intp)
        self.smooth: Indices = np.flatnonzero(every != NO_DERIVATIVE)
        self.slopes: Indices = every[self.smooth]
        apart = {column for column, _ in (*self._slow, *self._latched)} | {*self.stepped.tolist()}
        seen = set(ensemble.source.tolist())
        alone = [
            column
            for column in range(self.width)
            if column not in apart
            and (every[column] == NO_DERIVATIVE or self._places[column] not in seen)
        ]
        self.sampled: Indices = self._places[alone]
        self.nominal: Floats = np.array([recorded[c].variable.nominal for c in alone], np.float64)

    def surprise(self, predicted: Floats) -> float:
        """How far the sampled values are now from predicted ones, shape (S,).

        The largest of them, relative to nominal value plus size. Unlike a row, it is of values
        before their conversion to the unit of a driven input.
        """
        found = self.sample()
        scale = self.nominal + np.maximum(np.abs(predicted), np.abs(found))
        return float((np.abs(found - predicted) / scale).max(initial=0.0))

    def sample(self) -> Floats:
        """The sampled values as they are now, shape (S,)."""
        return self.ensemble.Y[self.sampled]

    @property
    def follows(self) -> bool:
        """Whether all recorded values follow from Y alone."""
        return not (self._latched or self._slow)

    @property
    def places(self) -> Indices | None:
        """Where the recorded values stand in Y, shape (M,), if all of them stand there as they
        are recorded."""
        return self._places if self.follows and not self._converted else None

    def fill(self, row: Floats) -> None:
        """Write the recorded values, shape (M,), into `row`."""
        ensemble = self.ensemble
        if ensemble.Y.size:
            ensemble.Y.take(self._places, out=row, mode="clip")
        for column, link in self._latched:
            row[column] = ensemble.C[0, link]
        for column, factor, offset in self._converted:
            row[column] = factor * row[column] + offset
        for column, item in self._slow:
            slave = ensemble.slaves[item.member]
            (value,) = slave.get_values(item.variable.type, [item.variable.reference])
            row[column] = float(value)
