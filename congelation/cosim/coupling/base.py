"""The contract of a coupling: how inputs move between communication points."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange

__all__ = ["Coupling", "Stepper"]


class Stepper(ABC):
    """A coupling at work on one system: advances it by a macro step at a time.

    Attributes
    ----------
    sweeps, calls : int
        Passes over all components, and fmi2 calls, made so far.
    estimated_error : float
        As in Statistics.
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
    """

    name: ClassVar[str]
    needs_derivatives: ClassVar[bool]
    lands_on_events: ClassVar[bool]

    @abstractmethod
    def stepper(self, ensemble: Ensemble, exchange: Exchange) -> Stepper:
        """This coupling at work on `ensemble`."""
