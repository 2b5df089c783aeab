"""The contract of a coupling: how inputs move between communication points."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange
from congelation.errors import InvalidInput

__all__ = ["AdaptiveStepper", "Coupling", "Stepper", "refuse_tolerance"]


class Stepper(ABC):
    """A coupling at work on one system: advances it by a macro step at a time.

    Attributes
    ----------
    sweeps, calls : int
        Passes over all components, and fmi2 calls, made so far; complete after `finish`.
    estimated_error : float
        As in Statistics; complete after `finish`.
    """

    sweeps: int
    calls: int
    estimated_error: float

    @abstractmethod
    def start(self, time: float) -> None:
        """Begin, or begin anew after a jump: outputs and inputs agree at `time`."""

    @abstractmethod
    def advance(self, time: float, end: float) -> None:
        """Step every slave from `time` to `end`; afterwards Y holds the outputs at `end`.

        Raises
        ------
        SlaveError
        RunEnded
        """

    @abstractmethod
    def finish(self) -> None:
        """Complete the statistics."""


class AdaptiveStepper(Stepper):
    """A stepper whose steps carry an error estimate and can be taken back.

    Attributes
    ----------
    order : int
        The estimate of the last trial falls with this power of the step.
    """

    order: int

    @abstractmethod
    def attempt(self, time: float, end: float) -> float:
        """Step from `time` to `end` for a trial, which `accept` or `reject` must follow.

        Returns
        -------
        float
            Estimated distance of an input from the output that drives it, relative to nominal
            value plus size; infinity where the sweeps did not converge.
        """

    @abstractmethod
    def accept(self) -> None:
        """Keep the step that was tried."""

    @abstractmethod
    def reject(self) -> None:
        """Take the step that was tried back, without a trace; also after an exception in it."""

    @abstractmethod
    def worst(self) -> str:
        """The connection that the last trial left in the largest error."""

    @abstractmethod
    def first_step(self) -> float:
        """A step from here over which the inputs change little, in seconds; may be infinite."""


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
    """

    name: ClassVar[str]
    needs_derivatives: ClassVar[bool]
    lands_on_events: ClassVar[bool]
    takes_tolerance: ClassVar[bool]

    @property
    @abstractmethod
    def rolls_back(self) -> bool:
        """Whether a step is repeated from saved states even where its length is fixed."""

    @property
    def periods(self) -> Mapping[str, float]:
        """Times between points that the coupling adds of its own, in seconds, by option."""
        return {}

    @abstractmethod
    def stepper(self, ensemble: Ensemble, exchange: Exchange, tolerance: float | None) -> Stepper:
        """This coupling at work on `ensemble`; an AdaptiveStepper where a tolerance is given.

        Raises
        ------
        InvalidInput
            The coupling knows no error estimate to hold against a tolerance.
        """


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
