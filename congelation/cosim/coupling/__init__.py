"""Couplings: how inputs move between communication points.

base            the contract, and what a trial of a step returns
auto            Auto, which stands for the most accurate one that the FMUs allow
held            Jacobi, GaussSeidel, Sampled
derivative      Derivative
hermite         Hermite; its polynomials in interpolant
model_exchange  ModelExchange, which is no co-simulation
points          what the links were at the last points, for Derivative and Hermite
polynomial      plain mathematics
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType

from congelation.cosim.coupling.auto import Auto
from congelation.cosim.coupling.base import (
    AdaptiveStepper,
    Coupling,
    Stepper,
    Trial,
    refuse_tolerance,
)
from congelation.cosim.coupling.derivative import Derivative
from congelation.cosim.coupling.held import GaussSeidel, Jacobi, Sampled
from congelation.cosim.coupling.hermite import Hermite
from congelation.cosim.coupling.model_exchange import ModelExchange
from congelation.errors import InvalidInput, nearest

__all__ = [
    "COUPLINGS",
    "AdaptiveStepper",
    "Auto",
    "Coupling",
    "Derivative",
    "GaussSeidel",
    "Hermite",
    "Jacobi",
    "ModelExchange",
    "Sampled",
    "Stepper",
    "Trial",
    "make_coupling",
    "refuse_tolerance",
]

COUPLINGS: Mapping[str, type[Coupling | Auto]] = MappingProxyType(
    {
        kind.name: kind
        for kind in (Auto, Jacobi, GaussSeidel, Derivative, Hermite, Sampled, ModelExchange)
    }
)
"""Every coupling by its name, and what stands for one."""


def make_coupling(name: str, options: Mapping[str, object] | None = None) -> Coupling | Auto:
    """A coupling from its name and options, as a scenario gives them.

    Raises
    ------
    InvalidInput
        An unknown name or option (the nearest valid one is named), or an option out of range.
    """
    if name not in COUPLINGS:
        raise InvalidInput(f"coupling '{name}'; {nearest(name, COUPLINGS)}")
    kind = COUPLINGS[name]
    fields = dataclasses.fields(kind)  # type: ignore[arg-type]  # all are dataclasses
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
    except InvalidInput as error:
        raise InvalidInput(f"coupling '{name}': {error}") from error
