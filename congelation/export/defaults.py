"""Whether the equations of an FMU can be evaluated with the defaults that its spec gives it."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping

import numpy as np

from congelation.errors import InvalidInput
from congelation.export.equations import Special
from congelation.theory.model import Model
from congelation.theory.values import complete_values

__all__ = ["check_defaults"]


def check_defaults(
    model: Model, given: Mapping[str, object], special: Special | None = None
) -> None:
    """Refuse defaults with which an FMU would refuse itself.

    Parameters
    ----------
    model : Model
        With the defaults of its form.
    given : mapping
        The spec's own, as `Model.with_defaults` takes them.
    special : Special, optional
        The equations that take the place of the model's at some values.

    Raises
    ------
    InvalidInput
        If a value is outside its domain, a gain does not exist, or the rates and outputs at the
        start are not finite; the text names the values without which they are.
    """
    lost = _not_finite(model.with_defaults(given), special)
    if not lost:
        return
    culprits = [name for name in given if _mends(model, given, name, special)] or list(given)
    named = ", ".join(f"{name} = {reprlib.repr(given[name])}" for name in culprits)
    raise InvalidInput(
        f"{named} cannot be used: {', '.join(lost)} would not be finite at the start; "
        "give values that are neither as large nor as small"
    )


def _mends(model: Model, given: Mapping[str, object], name: str, special: Special | None) -> bool:
    """Whether everything is finite without the given value of `name`."""
    fewer = {key: value for key, value in given.items() if key != name}
    try:
        return not _not_finite(model.with_defaults(fewer), special)
    except InvalidInput:
        return False


def _not_finite(model: Model, special: Special | None) -> list[str]:
    """Names of the rates, outputs and their derivatives that are not finite at the start."""
    values = complete_values(model)
    is_special = special is not None and all(
        values[name] == value for name, value in special.values.items()
    )
    used = special.model if special is not None and is_special else model
    start = {s.variables.name: s.start for s in model.states}
    named = {f"der({s.variables.name})": s.rate for s in used.states}
    for output in used.outputs:
        symbol, name = output.variables.symbol, output.variables.name
        named[name] = symbol
        if output.differentiated:
            named[f"der({name})"] = used.total_derivative(symbol)
    numbers = used.evaluate(list(named.values()), {**values, **start})
    return [name for name, n in zip(named, numbers, strict=True) if not np.isfinite(n).all()]
