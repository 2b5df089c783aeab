"""Formulas in the state, as text, read into CasADi expressions.

The text is parsed by Python's own grammar and never run: a formula is made of numbers, ``pi``, the
elements ``x[1]`` .. ``x[n]``, ``+ - * / **``, brackets, and smooth functions.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable

import casadi as ca

from congelation.errors import InvalidInput, nearest

__all__ = ["parse"]

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
    if len(text) > LONGEST:
        raise InvalidInput(f"a formula of {len(text)} characters; valid: {LONGEST} at most")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
        return _expression(tree, text, x, known)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(f"'{text}' is no formula; write one such as x[1]*sin(x[2])") from None


def _expression(node: ast.expr, text: str, x: ca.SX, known: int) -> ca.SX:
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            if not math.isfinite(value):
                raise InvalidInput(f"'{text}' holds a number that is not finite")
            return ca.SX(float(value))
        case ast.Name(id="pi"):
            return ca.SX(math.pi)
        case ast.Subscript(value=ast.Name(id="x"), slice=ast.Constant(value=int(j))):
            if not 1 <= j <= known:
                raise InvalidInput(
                    f"'{text}' holds x[{j}]; valid: x[1] to x[{known}], because row {known} of the "
                    "strict-feedback form (9) holds no others"
                )
            return x[j - 1]
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_expression(operand, text, x, known)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _expression(operand, text, x, known)
        case ast.BinOp(op=ast.BitXor()):
            raise InvalidInput(f"'{text}' holds ^; write a power with **, such as x[1]**2")
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            sides = (_expression(side, text, x, known) for side in (left, right))
            return _OPERATORS[type(op)](*sides)
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]):
            return _function(name, text)(_expression(argument, text, x, known))
        case ast.Call(func=ast.Name(id=name)):
            _function(name, text)  # an unknown name is the more helpful message
            raise InvalidInput(f"'{text}': {name} takes one argument")
        case ast.Name(id=name):
            raise InvalidInput(f"'{text}' holds '{name}'; valid: x[1] .. x[{known}] and pi")
        case _:
            raise InvalidInput(
                f"'{text}' is no formula of numbers, x[1] .. x[{known}], + - * / ** and "
                f"{', '.join(_FUNCTIONS)}"
            )


def _function(name: str, text: str) -> Callable[[ca.SX], ca.SX]:
    if name in _NOT_SMOOTH:
        raise InvalidInput(
            f"'{text}' holds {name}, which is not smooth; the recursion differentiates phi_i: use "
            "a smooth function in its place, such as tanh(x[1])"
        )
    if name not in _FUNCTIONS:
        raise InvalidInput(f"'{text}' holds '{name}'; {nearest(name, _FUNCTIONS)}")
    return _FUNCTIONS[name]
