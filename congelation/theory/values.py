"""The numbers of a model: given values, defaults for the rest, checked; and the computed gains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from congelation.errors import InvalidInput, amount, nearest, shown
from congelation.theory.gains import RULES
from congelation.theory.matrices import SYMMETRY_TOLERANCE
from congelation.theory.model import Domain, Gain, Model, Parameter

__all__ = ["complete_values"]

Values = dict[str, NDArray[np.float64]]


def complete_values(model: Model, given: Mapping[str, object] | None = None) -> Values:
    """Every parameter and gain of `model` by name, in its shape.

    Parameters
    ----------
    model : Model
    given : mapping, optional
        Values of parameters by name; scalars, or (nested) sequences in the parameter's shape. A
        gain may be given too, which then takes the place of its rule.

    Raises
    ------
    InvalidInput
        An unknown name, a wrong shape, or a value outside its domain.
    InfeasibleDesign
        If a gain does not exist for these values.
    """
    given = dict(given or {})
    parameters = {p.variables.name: p for p in model.parameters}
    shapes = {name: p.variables.shape for name, p in parameters.items()}
    shapes |= {g.variables.name: g.variables.shape for g in model.gains}
    for name in given:
        if name not in shapes:
            raise InvalidInput(f"{model.name} has no parameter '{name}': {nearest(name, shapes)}")
    values = model.defaults()
    values |= {name: _shaped(name, value, shapes[name]) for name, value in given.items()}
    for name, parameter in parameters.items():
        _check_domain(parameter, values[name])
    for gain in model.gains:
        if gain.variables.name not in given:
            arguments = [_argument(parameters[name], values[name]) for name in gain.arguments]
            values[gain.variables.name] = _computed(gain, arguments).reshape(gain.variables.shape)
    return values


def _computed(gain: Gain, arguments: Sequence[object]) -> NDArray[np.float64]:
    """What the rule of a gain finds, or the parameters that it fails with."""
    try:
        with np.errstate(all="ignore"):  # a value that is not finite is no solution, see below
            found = np.asarray(RULES[gain.rule](*arguments, **gain.constants))
    except InvalidInput:
        raise
    except (ArithmeticError, ValueError):  # the second: scipy, of matrices that are not finite
        found = np.array([np.nan])
    if np.isfinite(found).all():
        return found
    given = ", ".join(
        f"{name} = {shown(value)}" for name, value in zip(gain.arguments, arguments, strict=True)
    )
    raise InvalidInput(
        f"{gain.variables.name} cannot be computed from {given}: the numbers leave the range of "
        "double precision; give values that are neither as large nor as small"
    )


def _argument(parameter: Parameter, value: NDArray[np.float64]) -> object:
    return value if parameter.variables.indexed else value.item()


def _shaped(name: str, value: object, shape: tuple[int, int]) -> NDArray[np.float64]:
    try:
        array = np.asarray(value, dtype=float)
    except (OverflowError, TypeError, ValueError):
        raise InvalidInput(f"{name} = {shown(value)} is not valid; give numbers") from None
    if array.size != shape[0] * shape[1]:
        size = amount(shape[:1] if shape[1] == 1 else shape)
        raise InvalidInput(f"{name} = {shown(value)} is not valid; give {size}")
    return array.reshape(shape)


def _check_domain(parameter: Parameter, value: NDArray[np.float64]) -> None:
    domain, name = parameter.domain, parameter.variables.name
    if not np.isfinite(value).all() or not _inside(domain, value):
        raise InvalidInput(f"{name} = {shown(value)}; valid: {domain.value}")


def _inside(domain: Domain, value: NDArray[np.float64]) -> bool:
    match domain:
        case Domain.POSITIVE:
            return bool((value > 0).all())
        case Domain.NONNEGATIVE:
            return bool((value >= 0).all())
        case Domain.BOOLEAN:
            return bool(np.isin(value, (0.0, 1.0)).all())
        case Domain.SIGN:
            return bool(np.isin(value, (-1.0, 1.0)).all())
        case Domain.POSITIVE_DEFINITE:
            asymmetry = np.abs(value - value.T).max()
            symmetric = asymmetry <= SYMMETRY_TOLERANCE * np.abs(value).max()
            return bool(symmetric and np.linalg.eigvalsh(value).min() > 0)
        case Domain.REAL:
            return True
