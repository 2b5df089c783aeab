"""What lives in a worker: a program that runs a loop from t = 0."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from benchmarks.loop import Loop

__all__ = ["Engine", "Program", "Run"]


@dataclass(frozen=True)
class Run:
    """What a run took, and its rows.

    Parameters
    ----------
    seconds : float
        Of stepping; loading and initialisation are left out where the engine allows.
    rows : list of list of float
        Time and recorded values at each communication point after the start, where asked for.
    """

    seconds: float
    rows: list[list[float]] = field(default_factory=list)


class Program:
    """A program with a loop loaded; its method `run` takes its settings and `keep_rows`.

    Parameters
    ----------
    loop : Loop
    """

    def __init__(self, loop: Loop) -> None:
        self.loop = loop


class Engine(Program, ABC):
    """A co-simulation engine that holds inputs."""

    @abstractmethod
    def run(self, steps: int, step: float, *, keep_rows: bool) -> Run:
        """Run from t = 0 over `steps` macro steps of length `step`, in seconds."""
