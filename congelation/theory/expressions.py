"""Formulas in the state or in time, as text, read into CasADi expressions.

The text is parsed by Python's own grammar and never run: a formula is made of numbers, ``pi``, the
elements ``x[1]`` .. ``x[n]`` or the time ``t``, ``+ - * / **``, brackets, and smooth functions.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from congelation.errors import InvalidInput, counted, nearest

__all__ = ["known_variations", "parse", "parse_of_time"]

_FUNCTIONS: dict[str, Callable[[ca.SX], ca.SX]] = {
    name: getattr(ca, name) for name in ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh")
}
_NOT_SMOOTH = ("abs", "sign", "sgn", "min", "max", "floor", "ceil", "round", "mod")
_OPERATORS: dict[type[ast.operator], Callable[[ca.SX, ca.SX], ca.SX]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
LONGEST = 2000
"""Characters of a formula; Python's parser recurses, and a formula of a plant is a line."""


def parse(text: str, x: ca.SX, known: int) -> ca.SX:
    """A formula as an expression in x.

    Parameters
    ----------
    text : str
        Such as ``x[1]*sin(x[2])``.
    x : casadi.SX, shape (n, 1)
    known : int
        It may hold x_1 .. x_known only.

    Raises
    ------
    InvalidInput
        If it is no formula, or holds an unknown name or a function that is not smooth.
    """
    named = {f"x[{j}]": x[j - 1] for j in range(1, known + 1)}
    return _parse(
        _Formula(
            text, named, f"x[1] .. x[{known}]", "x[1]*sin(x[2])", "x[1]", "Nonlinear regressors"
        )
    )


def parse_of_time(text: str, t: ca.SX) -> ca.SX:
    """A formula as an expression in the time t, such as ``cos(2*t)``; see `parse`."""
    return _parse(_Formula(text, {"t": t}, "t", "cos(2*t)", "t", "Structured variations"))


@dataclass(frozen=True)
class _Formula:
    """A text, what its names stand for, and the words for messages about it."""

    text: str
    named: Mapping[str, ca.SX]
    valid: str
    example: str
    variable: str
    section: str


def _parse(formula: _Formula) -> ca.SX:
    text = formula.text
    try:
        if len(text) > LONGEST:
            raise InvalidInput(f"a formula of {len(text)} characters; valid: {LONGEST} at most")
        return _expression(ast.parse(text.strip(), mode="eval").body, formula)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        what = f"'{text}' is no formula; write one such as {formula.example}"
        if isinstance(error, InvalidInput):
            what = str(error)
        raise InvalidInput(f"{what} (docs/theory.md, '{formula.section}')") from None


def _expression(node: ast.expr, formula: _Formula) -> ca.SX:
    text, named = formula.text, formula.named
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            if not math.isfinite(value):
                raise InvalidInput(f"'{text}' holds a number that is not finite")
            return ca.SX(float(value))
        case ast.Name(id="pi"):
            return ca.SX(math.pi)
        case ast.Name(id=name) if name in named:
            return named[name]
        case ast.Subscript(value=ast.Name(id="x"), slice=ast.Constant(value=int(j))) if (
            "t" not in named
        ):
            if f"x[{j}]" not in named:
                known = len(named)
                raise InvalidInput(
                    f"'{text}' holds x[{j}]; valid: x[1] to x[{known}], because row {known} of the "
                    "strict-feedback form (9) holds no others"
                )
            return named[f"x[{j}]"]
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_expression(operand, formula)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _expression(operand, formula)
        case ast.BinOp(op=ast.BitXor()):
            raise InvalidInput(
                f"'{text}' holds ^; write a power with **, such as {formula.variable}**2"
            )
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            sides = (_expression(side, formula) for side in (left, right))
            return _OPERATORS[type(op)](*sides)
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]):
            return _function(name, formula)(_expression(argument, formula))
        case ast.Call(func=ast.Name(id=name)):
            _function(name, formula)  # an unknown name is the more helpful message
            raise InvalidInput(f"'{text}': {name} takes one argument")
        case ast.Name(id=name):
            raise InvalidInput(f"'{text}' holds '{name}'; valid: {formula.valid} and pi")
        case _:
            raise InvalidInput(
                f"'{text}' is no formula of numbers, {formula.valid}, + - * / ** and "
                f"{', '.join(_FUNCTIONS)}"
            )


def _function(name: str, formula: _Formula) -> Callable[[ca.SX], ca.SX]:
    if name in _NOT_SMOOTH:
        raise InvalidInput(
            f"'{formula.text}' holds {name}, which is not smooth; the recursion differentiates the "
            f"formula: use a smooth function in its place, such as tanh({formula.variable})"
        )
    if name not in _FUNCTIONS:
        raise InvalidInput(f"'{formula.text}' holds '{name}'; {nearest(name, _FUNCTIONS)}")
    return _FUNCTIONS[name]


def known_variations(rows: Sequence[Sequence[str]], p: int, n: int, t: ca.SX) -> ca.SX:
    """Upsilon(t), shape (p, q), of theta(t) = Upsilon(t) vartheta + .., from its formulas.

    Raises
    ------
    InvalidInput
        Formulas that are no p rows of one length, or that have no n derivatives at t = 0.
    """
    if len(rows) != p or len({len(row) for row in rows}) != 1:
        sizes = ", ".join(str(len(row)) for row in rows)
        raise InvalidInput(
            f"Upsilon has {counted(len(rows), 'row')} of {sizes} formulas; valid: a row for each "
            f"of the {p} elements of theta, all of one length"
        )
    parsed = [[parse_of_time(text, t) for text in row] for row in rows]
    for texts, row in zip(rows, parsed, strict=True):
        for text, formula in zip(texts, row, strict=True):
            derivatives = [formula]
            for _ in range(n):
                derivatives.append(ca.jacobian(derivatives[-1], t))
            (values,) = ca.substitute([ca.densify(ca.vertcat(*derivatives))], [t], [0])
            # CasADi makes |t| of sqrt(t**2), and gives it the slope 0 at 0.
            if "fabs" in str(formula) or not np.isfinite(np.asarray(ca.DM(values))).all():
                raise InvalidInput(
                    f"Upsilon holds {text}, which has not {n} derivatives at t = 0; the law needs "
                    "them: give a smooth function (docs/theory.md, 'Structured variations')"
                )
    return ca.vertcat(*(ca.horzcat(*row) for row in parsed))
