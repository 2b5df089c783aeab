"""The contract of a coupling: how inputs move between communication points.

A coupling is described by plain data (Coupling). At work on one system it is a Stepper, which holds
what follows from the system once and for all. Whatever changes from step to step is the state, a
value: a step takes one and returns the next, and never changes the one that it was given. The
fields of a state are numbers and flat arrays, as they would stand in a C struct.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from congelation.arguments import check_fields
from congelation.cosim.coupling.points import Points
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange
from congelation.errors import InvalidInput

__all__ = [
    "AdaptiveStepper",
    "Coupling",
    "Stepper",
    "StepsOnce",
    "Trial",
    "Watch",
    "refuse_tolerance",
]

Floats = npt.NDArray[np.float64]
S = TypeVar("S")

WATCHED_ROWS = 256
"""Steps looked at together: one array operation then costs next to nothing per step."""


class Trial(NamedTuple, Generic[S]):
    """What a trial of a step found.

    Parameters
    ----------
    state : S
        At the end of the step; drop it where the step is taken back.
    error : float
        Estimated distance of an input from the output that drives it, relative to nominal value
        plus size; infinity where the iterations did not converge.
    order : int
        The error falls with this power of the step.
    worst : int
        The link of the largest error.
    missed : array, shape (L,), or None
        The distance of each link from what was predicted, where inputs are.
    """

    state: S
    error: float
    order: int
    worst: int
    missed: Floats | None = None


class Stepper(ABC, Generic[S]):
    """A coupling at work on one system.

    Attributes
    ----------
    iterations : int
        Passes over all components made so far.
    calls_per_iteration : int
        fmi2 calls that one takes; what is called besides is counted by the ensemble.
    order : int
        Power of the step with which the error of a run falls, where everything is smooth.
    halves : bool
        Whether the error of a step is to be found by making it again in two halves, as the
        inputs cannot follow the polynomials whose error is known.
    predicts : bool
        Whether it is how far inputs were off at the end of a step, having been extrapolated.
    keeps : bool
        Whether a step that cannot be taken back, or is as short as steps may be, is kept whatever
        its error, rather than ending the run.
    """

    iterations: int
    calls_per_iteration: int
    order: int = 1
    halves: bool = False
    predicts: bool = False
    keeps: bool = False

    def renew(self) -> None:
        """Forget what an earlier run took."""
        self.iterations = 0

    @abstractmethod
    def start(self, time: float, before: S | None) -> S:
        """The state at the start, or after a jump, where outputs and inputs agree.

        Parameters
        ----------
        time : float
        before : S or None
            The state before the jump.
        """

    @abstractmethod
    def advance(self, state: S, time: float, end: float) -> S:
        """Step every slave from `time` to `end`; afterwards Y holds the outputs at `end`.

        Raises
        ------
        SlaveError
        RunEnded
        """

    @abstractmethod
    def largest_error(self) -> float:
        """Largest error of the steps made by `advance`, as in Statistics."""


class AdaptiveStepper(Stepper[S]):
    """A stepper whose steps carry an error estimate and can be taken back."""

    @abstractmethod
    def attempt(self, state: S, time: float, end: float) -> Trial[S]:
        """Step from `time` to `end` for a trial.

        The ensemble's saved states are those at `time`; they are for the caller to restore where
        the step is taken back.

        Raises
        ------
        StepDiscarded, SlaveError, RunEnded
        """

    @abstractmethod
    def points(self, state: S) -> Points:
        """The values and derivatives of the links that are part of a state."""

    @abstractmethod
    def first_step(self, state: S) -> float:
        """A step from here over which the inputs change little, in seconds; may be infinite, or 0
        where nothing is known."""


class Coupling(ABC):
    """How inputs move between communication points; plain data, described in its docstring.

    Attributes
    ----------
    name : str
        In COUPLINGS and in scenarios.
    needs_derivatives : bool
        Whether the der(.) outputs are read.
    lands_on_events : bool
        Whether communication points are placed on announced jumps.
    takes_tolerance : bool
        Whether its steps may be chosen by a tolerance.
    latches : bool
        Whether driven inputs keep their values over communication points, rather than taking
        those of their sources there.
    """

    name: ClassVar[str]
    needs_derivatives: ClassVar[bool] = False
    lands_on_events: ClassVar[bool] = False
    takes_tolerance: ClassVar[bool] = False
    latches: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_fields(self, "")

    @property
    @abstractmethod
    def rolls_back(self) -> bool:
        """Whether a step is repeated from saved states even where its length is fixed."""

    @property
    @abstractmethod
    def periods(self) -> Mapping[str, float]:
        """Times between points that the coupling adds of its own, in seconds, by option."""

    @abstractmethod
    def stepper(
        self, ensemble: Ensemble, exchange: Exchange, tolerance: float | None
    ) -> Stepper[Any]:
        """This coupling at work on `ensemble`; an AdaptiveStepper where it takes a tolerance."""


class StepsOnce(Coupling):
    """What the couplings have in common that make every step once, at the points that they get."""

    @property
    def rolls_back(self) -> bool:
        """No step is repeated."""
        return False

    @property
    def periods(self) -> Mapping[str, float]:
        """None."""
        return {}


def refuse_tolerance(coupling: Coupling, tolerance: float | None) -> None:
    """Refuse a tolerance for a coupling that takes none.

    Those hold inputs on purpose: how far off these are is not for a tolerance.

    Raises
    ------
    InvalidInput
    """
    if tolerance is not None and not coupling.takes_tolerance:
        raise InvalidInput(
            f"coupling '{coupling.name}' takes a fixed step; with a tolerance use 'hermite' or "
            "'derivative'"
        )


class Watch:
    """The largest distance of a link's value from where its held or extrapolated input was.

    It collects steps and looks at many together, since a Python loop pays for each array operation.

    Parameters
    ----------
    nominal : array, shape (L,)
    extrapolated : bool
        Whether inputs follow their derivative, rather than being held.
    """

    def __init__(self, nominal: Floats, *, extrapolated: bool) -> None:
        self._nominal = nominal
        self._largest = 0.0
        # What inputs start a step from: values, and derivatives where they follow them.
        shape = (2, len(nominal)) if extrapolated else (len(nominal),)
        self._rows: Floats = np.zeros((WATCHED_ROWS, *shape))
        self._extrapolated = extrapolated
        self._times: list[float] = []

    def clear(self) -> None:
        """Forget an earlier run."""
        self._times, self._largest = [], 0.0

    def row(self, time: float) -> Floats:
        """A row for what inputs start the next step from, shape (L,) or (2, L), to be filled."""
        count = len(self._times)
        if count == WATCHED_ROWS:
            self._evaluate()
            count = 1
        self._times.append(time)
        row: Floats = self._rows[count]
        return row

    def passed(self, time: float, row: Floats) -> None:
        """Go on from here: the steps up to `time` have been looked at elsewhere."""
        self._evaluate()
        self._times = [time]
        self._rows[0] = row

    def largest(self) -> float:
        """Relative to the link's nominal value plus its size."""
        self._evaluate()
        return self._largest

    def _evaluate(self) -> None:
        """Look at the collected steps; the last row begins the next batch."""
        count = len(self._times)
        rows = self._rows[:count]
        values = rows[:, 0] if self._extrapolated else rows
        if count > 1 and values.size:
            change = np.diff(values, axis=0)
            if self._extrapolated:
                change -= np.diff(self._times)[:, None] * rows[:-1, 1]
            relative = np.abs(change) / (self._nominal + np.abs(values[1:]))
            # The last step of a run that fails may have ended in a value that is no number.
            self._largest = max(self._largest, float(np.fmax.reduce(relative, axis=None)))
        if count:
            self._rows[0] = rows[-1]
            self._times = self._times[-1:]
