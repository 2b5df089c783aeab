"""Sweeps: the points of a design of experiments over any settings of a scenario.

A sweep crosses lists of settings with a sample of random ones:

    points = (list 1) x (list 2) x .. x (sample of all random axes together)

less the points that break a constraint. A list may set several things at once, which runs them
side by side (a zip). The sample is drawn in the unit cube and carried to each axis by the
inverse of its distribution function, so that plain random numbers, Latin hypercubes and Sobol
sequences work for every distribution. Equal seeds give equal points.

Each point may be repeated with fresh seeds in some settings. They are the same at every point
(common random numbers), so that what differs between points is not the luck of the draw.

References
----------
M. D. McKay, R. J. Beckman and W. J. Conover, A comparison of three methods for selecting values of
input variables .., Technometrics 21, 1979 (Latin hypercube).
A. B. Owen, Scrambling Sobol' and Niederreiter-Xing points, J. Complexity 14, 1998.
P. Glasserman and D. D. Yao, Some guidelines and guarantees for common random numbers, Management
Science 38, 1992.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from congelation.errors import InvalidInput
from congelation.scenario.constraint import Constraint
from congelation.scenario.parts import Scalar, Settings

__all__ = [
    "DISTRIBUTIONS",
    "SAMPLINGS",
    "Distribution",
    "RandomAxis",
    "Replicates",
    "Sweep",
]

Floats = npt.NDArray[np.float64]

EXACT = 2.0**53
"""Up to here every whole number is a float."""


@dataclass(frozen=True)
class Distribution:
    """A distribution with two parameters.

    Parameters
    ----------
    parameters : str
        What they are, for messages.
    valid : callable
        Whether two numbers can be its parameters.
    inverse : callable
        (u, a, b) -> value for u in (0, 1): the inverse of the distribution function. What overflows
        is infinite.
    bounded : bool
        Whether the ends of (0, 1) give values that are drawn in earnest.
    """

    parameters: str
    valid: Callable[[float, float], bool]
    inverse: Callable[[float, float, float], Scalar]
    bounded: bool = True


def _normal_quantile(u: float, mean: float, deviation: float) -> float:
    return mean + deviation * float(scipy.special.ndtri(u))


DISTRIBUTIONS: Mapping[str, Distribution] = {
    "uniform": Distribution(
        "[low, high] with low < high",
        lambda a, b: a < b,
        lambda u, a, b: min(a * (1.0 - u) + b * u, b),
    ),
    "log_uniform": Distribution(
        "[low, high] with 0 < low < high",
        lambda a, b: 0.0 < a < b,
        lambda u, a, b: min(max(a, a ** (1.0 - u) * b**u), b),
    ),
    "normal": Distribution(
        "[mean, standard deviation] with a positive deviation",
        lambda a, b: b > 0.0,
        _normal_quantile,
        bounded=False,
    ),
    "integers": Distribution(
        "[first, last], whole numbers of at most 2^53 with first < last",
        lambda a, b: -EXACT <= a < b <= EXACT and a == math.floor(a) and b == math.floor(b),
        lambda u, a, b: min(int(a) + math.floor(u * (b - a + 1.0)), int(b)),
    ),
}


def _random(samples: int, dimensions: int, rng: np.random.Generator) -> Floats:
    return rng.random((samples, dimensions))


def _latin_hypercube(samples: int, dimensions: int, rng: np.random.Generator) -> Floats:
    points: Floats = scipy.stats.qmc.LatinHypercube(dimensions, rng=rng).random(samples)
    return points


def _sobol(samples: int, dimensions: int, rng: np.random.Generator) -> Floats:
    points: Floats = scipy.stats.qmc.Sobol(dimensions, rng=rng).random_base2(
        samples.bit_length() - 1
    )
    return points


SAMPLINGS: Mapping[str, Callable[[int, int, np.random.Generator], Floats]] = {
    "random": _random,
    "latin_hypercube": _latin_hypercube,
    "sobol": _sobol,
}
"""(samples, dimensions, rng) -> points in the unit cube; a Sobol sequence has 2^k of them."""

# The ends of (0, 1) that are kept clear, so that no normal deviate is infinite.
_SMALLEST = 2.0**-53


@dataclass(frozen=True)
class RandomAxis:
    """A setting drawn from one of `DISTRIBUTIONS`; `place` is where the scenario says so."""

    name: str
    distribution: str
    parameters: tuple[float, float]
    place: str = ""

    def value(self, u: float) -> Scalar:
        """The value below which a fraction `u` of all draws lies."""
        inside = min(max(u, _SMALLEST), 1.0 - _SMALLEST)
        return DISTRIBUTIONS[self.distribution].inverse(inside, *self.parameters)


@dataclass(frozen=True)
class Replicates:
    """Repetitions of every point with fresh seeds.

    Parameters
    ----------
    count : int
    reseeded : tuple of str
        The settings that get a seed of their own in each repetition.
    """

    count: int
    reseeded: tuple[str, ...]

    def seeds(self, seed: int) -> Iterator[dict[str, Scalar]]:
        """The settings of each repetition: whole numbers of 31 bits, no two of them equal.

        Those of a repetition depend on its number and on `seed` alone, not on `count`.
        """
        taken: set[int] = set()
        for number in range(self.count):
            for attempt in itertools.count():
                sequence = np.random.SeedSequence(seed, spawn_key=(number, attempt))
                words = sequence.generate_state(len(self.reseeded)) >> 1
                drawn = [int(word) for word in words]
                if len({*drawn} - taken) == len(drawn):
                    break
            taken.update(drawn)
            yield dict(zip(self.reseeded, drawn, strict=True))


@dataclass(frozen=True)
class Sweep:
    """A design of experiments.

    Parameters
    ----------
    lists : tuple of tuple of mapping
        Lists of settings, crossed with each other and with the sample.
    axes : tuple of RandomAxis
    sampling : str
        One of `SAMPLINGS`.
    samples : int
        Number of draws, 0 if there are no random axes.
    seed : int
    trajectories : bool
        Whether trajectories are kept, or metrics alone.
    timeout : float, optional
        Seconds that a run may take.
    constraints : tuple of Constraint
        Points that do not satisfy all of them are left out.
    replicates : Replicates, optional
        How each point is repeated.
    variants : tuple of tuple of str
        Names of the variants that each of `lists`, and then of `axes`, is of; an empty tuple, or
        one left out at the end: of all. The other variants have no such axis.
    """

    lists: tuple[tuple[Settings, ...], ...] = ()
    axes: tuple[RandomAxis, ...] = ()
    sampling: str = "random"
    samples: int = 0
    seed: int = 0
    trajectories: bool = False
    timeout: float | None = None
    constraints: tuple[Constraint, ...] = ()
    replicates: Replicates | None = None
    variants: tuple[tuple[str, ...], ...] = ()

    @property
    def size(self) -> int:
        """Number of points of a variant that has all axes, less none by constraints."""
        return math.prod(len(entries) for entries in self.lists) * max(self.samples, 1)

    def together(self) -> tuple[tuple[str, ...], ...]:
        """The settings of each axis."""
        return (*(tuple(entries[0]) for entries in self.lists), *((a.name,) for a in self.axes))

    def names(self) -> tuple[str, ...]:
        """The settings that differ between runs."""
        reseeded = self.replicates.reseeded if self.replicates is not None else ()
        swept = (*(name for names in self.together() for name in names), *reseeded)
        return tuple(dict.fromkeys(swept))  # two axes may set the same, for different variants

    def of_variant(self, name: str) -> Sweep:
        """The sweep of one variant: without the axes that are of others alone.

        Its sample is the same one, without the columns of those axes, so that what is drawn for
        several variants is equal for all of them. Constraints on settings that it does not sweep
        do not apply.
        """
        mine = [not names or name in names for names in self._variants]
        if all(mine):
            return self
        lists, drawn = mine[: len(self.lists)], mine[len(self.lists) :]
        axes = tuple(itertools.compress(self.axes, drawn))
        part = replace(
            self,
            lists=tuple(itertools.compress(self.lists, lists)),
            axes=axes,
            samples=self.samples if axes else 0,
            constraints=(),
            variants=(),
        )
        swept = part.names()
        applied = tuple(c for c in self.constraints if all(name in swept for name in c.names))
        part = replace(part, constraints=applied)
        if axes:
            part.__dict__["_sample"] = self._sample[:, drawn]  # what the property would draw anew
        return part

    @property
    def _variants(self) -> tuple[tuple[str, ...], ...]:
        """`variants`, with an entry for every axis."""
        number = len(self.lists) + len(self.axes)
        return (*self.variants, *[()] * (number - len(self.variants)))

    def document(self) -> dict[str, object]:
        """The table of a scenario file that says the same.

        Raises
        ------
        InvalidInput
            If the settings of a list are not all of the same names.
        """
        axes = [_list_table(entries, place) for place, entries in enumerate(self.lists)]
        axes += [{"set": a.name, a.distribution: list(a.parameters)} for a in self.axes]
        for axis, names in zip(axes, self._variants, strict=False):
            if names:
                axis["variants"] = list(names)
        table: dict[str, object] = {
            "axes": axes,
            "seed": self.seed,
            "trajectories": self.trajectories,
            "constraints": [constraint.text for constraint in self.constraints],
        }
        if self.axes:
            table |= {"samples": self.samples, "sampling": self.sampling}
        if self.timeout is not None:
            table["timeout"] = self.timeout
        if self.replicates is not None:
            table["replicates"] = self.replicates.count
            table["reseed"] = list(self.replicates.reseeded)
        return table

    def points(self) -> Iterator[dict[str, Scalar]]:
        """The settings of every point that the constraints leave, the sample's varying fastest."""
        return (point for place in range(self.size) if self.holds(point := self.point(place)))

    def point(self, place: int) -> dict[str, Scalar]:
        """The settings of a point by its place among all, those that break a constraint included.

        No other point is computed, so that a study goes on in the middle at once.
        """
        point: dict[str, Scalar] = {}
        if self.axes:
            place, draw = divmod(place, self.samples)
            for axis, u in zip(self.axes, self._sample[draw].tolist(), strict=True):
                point[axis.name] = axis.value(u)
        for entries in reversed(self.lists):
            place, entry = divmod(place, len(entries))
            point = {**entries[entry], **point}
        return point

    def parts(self, names: Collection[str], most: int) -> Iterator[list[dict[str, Scalar]]]:
        """The different values of some settings, of each list and of the sample.

        The points of the sweep have the products of these parts. Of a sample with more than `most`
        draws only those with the least and the largest value of each setting are given.
        """
        for entries in self.lists:
            kept = ({name: v for name, v in entry.items() if name in names} for entry in entries)
            yield list({tuple(entry.items()): entry for entry in kept}.values())
        mine = [k for k, axis in enumerate(self.axes) if axis.name in names]
        if mine:
            sample = self._sample[:, mine]
            if len(sample) > most:
                ends = np.concatenate([sample.argmin(axis=0), sample.argmax(axis=0)])
                sample = sample[np.unique(ends)]
            axes = [self.axes[k] for k in mine]
            yield [
                {axis.name: axis.value(u) for axis, u in zip(axes, draw, strict=True)}
                for draw in sample.tolist()
            ]

    def holds(self, point: Settings) -> bool:
        """Whether a point satisfies all constraints."""
        return all(constraint.holds(point) for constraint in self.constraints)

    def repetitions(self) -> Iterator[tuple[int | None, Settings]]:
        """The number, from 1, and the settings of each repetition of a point.

        Without replicates there is one, which has no number.
        """
        if self.replicates is None:
            yield None, {}
        else:
            yield from enumerate(self.replicates.seeds(self.seed), start=1)

    @cached_property
    def _sample(self) -> Floats:
        """The draws of all random axes in the unit cube, shape (samples, axes)."""
        rng = np.random.default_rng(self.seed)
        return SAMPLINGS[self.sampling](self.samples, len(self.axes), rng)


def _list_table(entries: Sequence[Settings], place: int) -> dict[str, object]:
    """A list of settings as an axis that changes several of them together."""
    names = list(entries[0]) if entries else []
    for entry in entries:
        if entry.keys() != entries[0].keys():
            raise InvalidInput(
                f"Scenario: sweep.lists[{place}] do not all set the same variables; "
                f"give each of them {', '.join(names)}"
            )
    return {"set": names, "values": [[entry[name] for name in names] for entry in entries]}
