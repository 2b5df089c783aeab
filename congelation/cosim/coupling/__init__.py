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
from congelation.errors import InvalidInput, nearest

__all__ = [
    "COUPLINGS",
    "AdaptiveStepper",
    "Coupling",
    "Derivative",
    "GaussSeidel",
    "Hermite",
    "Jacobi",
    "Stepper",
    "make_coupling",
]

COUPLINGS: Mapping[str, type[Coupling]] = MappingProxyType(
    {kind.name: kind for kind in (Jacobi, GaussSeidel, Derivative, Hermite)}
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
    known = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]  # all are
    for option in options or {}:
        if option not in known:
            hint = nearest(option, known) if known else "it takes no options"
            raise InvalidInput(f"coupling '{name}': no option '{option}'; {hint}")
    return kind(**dict(options or {}))
