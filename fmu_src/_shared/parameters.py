"""From the values of the parameters to equations closed over them."""

from __future__ import annotations

from collections import namedtuple

from . import equations, interface
from .gains import RULES
from .linear_algebra import cholesky

__all__ = ["Bound", "ParameterError", "bind"]

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
        If a value is outside its domain, or the gains do not exist.
    """
    flat, arguments = [], {}
    for name, domain, references, columns, indexed in interface.PARAMETERS:
        values = [constants[vr] for vr in references]
        _check(name, domain, references, values, columns)
        numbers = [float(value) for value in values]
        flat += numbers
        arguments[name] = _shaped(numbers, columns) if indexed else numbers[0]
    gains = []
    for name, rule, names, fixed in interface.RULES:
        try:
            found = RULES[rule](*[arguments[n] for n in names], **fixed)
        except (ArithmeticError, ValueError) as error:
            raise ParameterError(f"{name}: {error}") from error
        gains += found
    return Bound(*equations.bind(*flat, *gains), gains)


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
