"""What a run leaves behind: its status, its rows and what it cost."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np
import numpy.typing as npt

from congelation.errors import InvalidInput, counted, nearest

__all__ = ["Result", "RunEnded", "Statistics", "Status", "Trust"]

Floats = npt.NDArray[np.float64]


class Status(Enum):
    """How a run ended; each value is a sentence, and a remedy where one is needed.

    Examples
    --------
    >>> cg.Status.COMPLETED.value
    'The run reached its stop time.'
    """

    COMPLETED = "The run reached its stop time."
    TERMINATED = "An FMU ended the run before its stop time; what it says is no failure."
    SLAVE_FAILED = (
        "An FMU refused a call; correct what its message names, or shorten the communication step."
    )
    NON_FINITE = (
        "A value became infinite or nan; shorten the communication step, or use the coupling "
        "'hermite' with a tolerance."
    )
    DIVERGED = (
        "A value passed 1e100; the loop is unstable as designed or as coupled: check the gains, "
        "shorten the communication step, or use the coupling 'hermite' with a tolerance."
    )
    NOT_CONVERGED = (
        "The iterations over a macro step did not converge; shorten the communication step, or "
        "give a tolerance so that it is chosen for you."
    )
    LOOP_UNSOLVED = (
        "An algebraic loop could not be solved; give start values nearer to its solution, or "
        "break the loop with a component that has a state."
    )
    TOO_MANY_STEPS = (
        "The run took max_steps steps before its stop time; allow more, loosen the tolerance, or "
        "choose a longer communication step."
    )
    STEP_TOO_SMALL = (
        "The tolerance asks for communication steps below the resolution of time; loosen it, or "
        "look for a jump that no component announces."
    )


class RunEnded(Exception):
    """A numerical outcome on its way to the result."""

    def __init__(self, status: Status, message: str) -> None:
        super().__init__(message)
        self.status = status
        self.message = message


@dataclass(frozen=True)
class Statistics:
    """What a run took.

    Parameters
    ----------
    macro_steps : int
        Communication steps accepted.
    rejected : int
        Steps taken back because their estimated error was too large, or the iterations did not
        converge.
    iterations : int
        Passes over all components, those of rejected steps included.
    fmi_calls : int
        Calls of fmi2 functions during the stepping loop.
    events : int
        Announced jumps on which a communication point was placed.
    floors : int
        Of the steps chosen by a tolerance, those whose error came from the FMUs' own integration,
        so that a shorter step did not better it.
    warnings : int
        Messages of status fmi2Warning that the FMUs logged.
    estimated_error : float
        Largest estimated distance of an input, while its FMU stepped, from the output that
        drives it, relative to the output's nominal value plus its size.
    wall_time : float
        Seconds, initialisation included.
    order : int
        Power of the step with which the error of the run falls, where everything is smooth.
    parts : int
        Steps that each macro step consists of: two where it is made in halves, which are kept.
    looks_ahead : bool
        Whether the run was made again, to end steps before jumps that FMUs make when their next
        step begins.
    """

    macro_steps: int = 0
    rejected: int = 0
    iterations: int = 0
    fmi_calls: int = 0
    events: int = 0
    floors: int = 0
    warnings: int = 0
    estimated_error: float = 0.0
    wall_time: float = 0.0
    order: int = 1
    parts: int = 1
    looks_ahead: bool = False


@dataclass(frozen=True, eq=False)
class Trust:
    """How far the values of a run may be off, see `congelation.cosim.error_bars`.

    Parameters
    ----------
    verdict : str
        "resolved", "rough" or "not resolved": that of the worst variable. "unknown", or the status
        of the run that was to tell, where there is no number.
    line : str
        The same in one sentence.
    error : float or None
        The widest band, relative to the peak of its variable.
    bands : array, shape (N, M), or None
        Half the width of the bands around the values of the run.
    relative : array, shape (M,)
        The widest band of each variable, over its peak; of a switched one, the share of the time
        in which the runs differ.
    verdicts : tuple of str, length M
    since : tuple of (float or None), length M
        When the band first passes a tenth of the peak, in seconds.
    order : float or None
        Power of the step with which the error falls: as expected, or observed where that was asked
        for.
    runs : float
        Macro steps of all runs over those of the run itself.
    """

    verdict: str
    line: str
    error: float | None = None
    bands: Floats | None = None
    relative: Floats = field(default_factory=lambda: np.empty(0))
    verdicts: tuple[str, ...] = ()
    since: tuple[float | None, ...] = ()
    order: float | None = None
    runs: float = 1.0

    @classmethod
    def unknown(cls, reason: str, verdict: str = "unknown") -> Trust:
        """The error bars of a run whose error is unknown."""
        return cls(verdict, f"trust: the error is unknown: {reason}")


SHOWN = 8
"""Names of variables that the text of a result lists."""


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """The rows of a run, and how it ended.

    Parameters
    ----------
    status : Status
    message : str
        One line: the status in the words of this run (component, time, reason).
    time : array, shape (N,)
        Communication points in seconds; the first is the start time.
    names : tuple of str, length M
        "component.variable".
    values : array, shape (N, M)
        Row k holds the values at time[k]. Where a sink took the rows, `time` and `values` hold
        the last one alone.
    statistics : Statistics
    trust : Trust or None
        Where error bars were asked for. The columns "error(component.variable)" are their bands.
    coupling : str
        Name of the coupling that the run had.
    choice : str
        Where it was "auto": which coupling that was, and why, in one line.

    Examples
    --------
    >>> system = cg.load_scenario("scenarios/scalar.toml").system
    >>> result = cg.simulate(system, stop_time=1.0, step=0.01)
    >>> result.values.shape == (len(result.time), len(result.names))
    True
    """

    status: Status
    message: str
    time: npt.NDArray[np.float64]
    names: tuple[str, ...]
    values: npt.NDArray[np.float64]
    statistics: Statistics
    trust: Trust | None = None
    coupling: str = ""
    choice: str = ""

    def __repr__(self) -> str:
        """The end of the run and its size, not its rows."""
        span = f"{self.time[0]:g} .. {self.time[-1]:g} s" if len(self.time) else "no rows"
        names = ", ".join(self.names[:SHOWN]) + (", .." if len(self.names) > SHOWN else "")
        rows, steps = len(self.time), self.statistics.macro_steps
        return "\n".join(
            [
                f"Result: {self.status.name}, {counted(rows, 'row')} of {len(self.names)}, {span}",
                f"  {self.message}",
                f"  {names}",
                f"  {counted(steps, 'step')}, {self.statistics.rejected} rejected",
            ]
        )

    @property
    def completed(self) -> bool:
        """Whether the run reached its stop time."""
        return self.status is Status.COMPLETED

    @property
    def whole(self) -> bool:
        """Whether the run ended without a failure, at its stop time or where an FMU ended it."""
        return self.status in (Status.COMPLETED, Status.TERMINATED)

    def column(self, name: str) -> npt.NDArray[np.float64]:
        """The values of one variable, shape (N,); of a vector by its bare name, shape (N, n)."""
        if name in self.names:
            return self.values[:, self.names.index(name)]
        elements = [k for k, other in enumerate(self.names) if other.rpartition("[")[0] == name]
        if not elements:
            raise InvalidInput(f"no column '{name}'; {nearest(name, self.names)}")
        return self.values[:, elements]
