"""The coupling that stands for the most accurate one that the FMUs allow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from congelation.cosim.coupling.base import Coupling, Stepper
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange
from congelation.errors import InvalidInput

__all__ = ["Auto"]


@dataclass(frozen=True)
class Auto(Coupling):
    """The most accurate coupling that the FMUs allow, found before the run begins.

    What FMUs declare is tried out in a few steps, see `congelation.cosim.choice`. The run is then
    one of the coupling found: `Result.coupling` names it, and `Result.choice` says why.

    Examples
    --------
    >>> system = cg.load_scenario("scenarios/scalar.toml").system
    >>> cg.simulate(system, stop_time=0.5, tolerance=1e-4, coupling="auto").coupling
    'hermite'
    """

    name: ClassVar[str] = "auto"
    needs_derivatives: ClassVar[bool] = True
    lands_on_events: ClassVar[bool] = True
    takes_tolerance: ClassVar[bool] = True
    latches: ClassVar[bool] = False

    @property
    def rolls_back(self) -> bool:
        """Not of necessity."""
        return False

    @property
    def periods(self) -> Mapping[str, float]:
        """None."""
        return {}

    def stepper(
        self, ensemble: Ensemble, exchange: Exchange, tolerance: float | None
    ) -> Stepper[Any]:
        """It has none of its own.

        Raises
        ------
        InvalidInput
            Always.
        """
        raise InvalidInput(
            f"coupling '{self.name}' stands for another one, which simulate and perform find; "
            "give that one"
        )
