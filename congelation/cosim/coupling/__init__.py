"""Couplings: how inputs move between communication points, one file each."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType

from congelation.cosim.coupling.base import AdaptiveStepper, Coupling, Stepper
from congelation.cosim.coupling.derivative import Derivative
from congelation.cosim.coupling.gauss_seidel import GaussSeidel
from congelation.cosim.coupling.hermite import Hermite
from congelation.cosim.coupling.jacobi import Jacobi
from congelation.cosim.coupling.sampled import Sampled
from congelation.errors import InvalidInput, nearest

__all__ = [
    "COUPLINGS",
    "AdaptiveStepper",
    "Coupling",
    "Derivative",
    "GaussSeidel",
    "Hermite",
    "Jacobi",
    "Sampled",
    "Stepper",
    "make_coupling",
]

COUPLINGS: Mapping[str, type[Coupling]] = MappingProxyType(
    {kind.name: kind for kind in (Jacobi, GaussSeidel, Derivative, Hermite, Sampled)}
)
"""Every coupling by its name."""


def make_coupling(name: str, options: Mapping[str, object] | None = None) -> Coupling:
    """A coupling from its name and options, as a scenario gives them.

    Raises
    ------
    InvalidInput
        An unknown name or option (the nearest valid one is named), or an option out of range.
    """
    if name not in COUPLINGS:
        raise InvalidInput(f"coupling '{name}'; {nearest(name, COUPLINGS)}")
    kind = COUPLINGS[name]
    fields = dataclasses.fields(kind)  # type: ignore[arg-type]  # every coupling is a dataclass
    known = [field.name for field in fields]
    given = dict(options or {})
    for option in given:
        if option not in known:
            hint = nearest(option, known) if known else "it takes no options"
            raise InvalidInput(f"coupling '{name}': no option '{option}'; {hint}")
    for field in fields:
        if field.default is dataclasses.MISSING and field.name not in given:
            raise InvalidInput(f"coupling '{name}' needs the option '{field.name}'")
    try:
        return kind(**given)
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"coupling '{name}': {error}") from error
