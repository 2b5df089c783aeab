"""What stands for a coupling that is still to be found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

__all__ = ["Auto"]


@dataclass(frozen=True)
class Auto:
    """The most accurate coupling that the FMUs allow, found before the run begins.

    It is no coupling: what FMUs declare is tried out in a few steps, see
    `congelation.cosim.choice`, and the run is one of the coupling found. `Result.coupling` names
    that, and `Result.choice` says why it was taken.

    Examples
    --------
    >>> system = cg.load_scenario("scenarios/scalar.toml").system
    >>> cg.simulate(system, stop_time=0.5, tolerance=1e-4, coupling="auto").coupling
    'hermite'
    """

    name: ClassVar[str] = "auto"
