"""From the values of the parameters to equations closed over them."""

from __future__ import annotations

from collections import namedtuple

from . import equations, interface
from .gains import RULES, Infeasible
from .linear_algebra import cholesky

__all__ = ["Bound", "ParameterError", "bind", "reason"]

# Gamma counts as symmetric where its halves agree to this relative difference.
SYMMETRY = 1e-12

Bound = namedtuple("Bound", "rates outputs derivatives step gains")


class ParameterError(ValueError):
    """A parameter is not valid; the text names it, its value, and what would be valid."""


def bind(constants):
    """Check the parameters, compute the gains and close the equations over both.

    Parameters
    ----------
    constants : dict
        Value of every parameter by its value reference.

    Raises
    ------
    ParameterError
        If a value is outside its domain, the gains do not exist, or arithmetic fails for values
        as large or small as these.
    """
    groups = {}
    for name, domain, references, columns, _ in interface.PARAMETERS:
        groups[name] = [constants[vr] for vr in references]
        _check(name, domain, references, groups[name], columns)
    try:
        return _closed(groups)
    except _Uncomputable as error:
        raise ParameterError(_blame(groups, error)) from error


def reason(error):
    """What went wrong in an evaluation, in words: Python's own do not say it."""
    if isinstance(error, OverflowError):
        return "a number becomes too large"
    if isinstance(error, ZeroDivisionError):
        return "a division by zero"
    return str(error)


class _Uncomputable(ArithmeticError):
    """Values inside their domains, of sizes that floating-point arithmetic cannot combine."""


def _closed(groups):
    """The gains, and the equations closed over parameters and gains."""
    flat, arguments, gains = [], {}, []
    for name, _, _, columns, indexed in interface.PARAMETERS:
        numbers = [float(value) for value in groups[name]]
        flat += numbers
        arguments[name] = _shaped(numbers, columns) if indexed else numbers[0]
    for name, rule, names, fixed in interface.RULES:
        gains += _computed(name, RULES[rule], *[arguments[n] for n in names], **fixed)
    return Bound(*_computed("the equations", equations.bind, *flat, *gains), gains)


def _computed(what, compute, *arguments, **fixed):
    """What `compute` returns; an error of its says `what` it was of."""
    try:
        return compute(*arguments, **fixed)
    except Infeasible as error:
        raise ParameterError(f"{what}: {error}") from error
    except (ArithmeticError, ValueError) as error:
        raise _Uncomputable(f"{what} cannot be computed ({reason(error)})") from error


def _blame(groups, error):
    """The text of an error that names the parameters whose defaults would mend it.

    Where no single one does, all that differ from their defaults are named.
    """
    defaults = {
        name: [interface.VARIABLES[vr].start for vr in references]
        for name, _, references, _, _ in interface.PARAMETERS
    }
    changed = [name for name in groups if groups[name] != defaults[name]]
    culprits = [name for name in changed if _is_computable({**groups, name: defaults[name]})]
    named = [
        (interface.VARIABLES[vr].name, value, default)
        for name, _, references, _, _ in interface.PARAMETERS
        for vr, value, default in zip(references, groups[name], defaults[name])
        if name in (culprits or changed) and value != default
    ]
    if not named:
        return f"the default parameters are refused: {error}"
    given = ", ".join(f"{name} = {value}" for name, value, _ in named)
    valid = ", ".join(f"{name} = {default}" for name, _, default in named)
    return f"{given} cannot be used: {error}; valid with the other values: {valid}"


def _is_computable(groups):
    try:
        _closed(groups)
    except (_Uncomputable, ParameterError):
        return False
    return True


def _shaped(numbers, columns):
    """A vector as a list, a matrix as a list of rows."""
    return numbers if columns == 1 else _rows(numbers, columns)


def _rows(numbers, columns):
    return [numbers[i : i + columns] for i in range(0, len(numbers), columns)]


def _check(name, domain, references, values, columns):
    if domain == "POSITIVE_DEFINITE":
        _check_positive_definite(name, _rows(values, columns))
        return
    valid, phrase = _DOMAINS[domain]
    for vr, value in zip(references, values):
        if not valid(value):
            raise ParameterError(
                f"{interface.VARIABLES[vr].name} = {value} is refused: it must be {phrase}"
            )


def _check_positive_definite(name, rows):
    size = max(abs(value) for row in rows for value in row)
    for i, row in enumerate(rows):
        for j in range(i):
            if abs(row[j] - rows[j][i]) > SYMMETRY * size:
                raise ParameterError(
                    f"{name} is refused: it must be symmetric, but {name}[{i + 1},{j + 1}] = "
                    f"{row[j]} and {name}[{j + 1},{i + 1}] = {rows[j][i]}"
                )
    if cholesky(rows) is None:
        raise ParameterError(f"{name} is refused: it must be positive definite")


_DOMAINS = {
    "REAL": (lambda value: True, "finite"),
    "POSITIVE": (lambda value: value > 0.0, "positive"),
    "NONNEGATIVE": (lambda value: value >= 0.0, "non-negative"),
    "BOOLEAN": (lambda value: True, "true or false"),
    "SIGN": (lambda value: value in (-1.0, 1.0), "+1 or -1"),
}
