"""Constraints on the points of a sweep: comparisons of settings, such as ``a.x <= 2 * b.y``.

The text is read as Python's expressions are, but only comparisons, `and`, `or`, `not` and
arithmetic with numbers and names of settings mean anything here; nothing is ever executed.
"""

from __future__ import annotations

import ast
import copy
import operator
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from congelation.errors import InvalidInput, nearest

__all__ = ["Constraint"]

DEEPEST = 100
"""Operations inside each other: Python's own stack ends a few hundred further down."""


SHOWN = 60
"""Characters of a long constraint that a message quotes."""


def _power(base: float, exponent: float) -> Any:
    return float(base) ** float(exponent)  # a whole number may take for ever, a float overflows


_ARITHMETIC: Mapping[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: _power,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: operator.not_,
}
_COMPARISONS: Mapping[type[ast.AST], Callable[[Any, Any], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_NAMES = (ast.Name, ast.Attribute, ast.Subscript)


@dataclass(frozen=True)
class Constraint:
    """A condition on the settings of a point.

    Parameters
    ----------
    text : str
        A comparison of expressions in numbers, strings and names ``owner.key`` of settings.

    Raises
    ------
    InvalidInput
        If it is no such comparison.
    """

    text: str

    def __post_init__(self) -> None:
        if _depth(self._tree) > DEEPEST:
            raise InvalidInput(self._too_long())
        for node in ast.walk(self._tree):
            if not _is_known(node):
                raise InvalidInput(f"'{self.text}': '{ast.unparse(node)}' has no meaning here")
        if not isinstance(self._tree, ast.Compare | ast.BoolOp | ast.UnaryOp):
            raise InvalidInput(f"'{self.text}' compares nothing; give such as 'a.x <= 2 * b.y'")

    @property
    def names(self) -> tuple[str, ...]:
        """The settings that it is of."""
        return tuple(dict.fromkeys(_names_in(self._tree)))

    def renamed(self, names: Mapping[str, str]) -> Constraint:
        """The same condition, of settings under other names."""
        if not any(names.get(name, name) != name for name in self.names):
            return self
        return Constraint(ast.unparse(_Renamed(names).visit(copy.deepcopy(self._tree))))

    def check_names(self, known: Iterable[str]) -> None:
        """Raise InvalidInput unless all names are among those known."""
        names = list(known)
        for name in _names_in(self._tree):
            if name not in names:
                raise InvalidInput(f"'{self.text}': '{name}' is not swept; {nearest(name, names)}")

    def holds(self, settings: Mapping[str, object]) -> bool:
        """Whether the settings satisfy it.

        Raises
        ------
        InvalidInput
            If it cannot be evaluated: a division by zero, a comparison of unequal types.
        """
        try:
            return bool(_value(self._tree, settings))
        except (ArithmeticError, MemoryError, TypeError, ValueError) as error:
            raise InvalidInput(f"'{self.text}' cannot be evaluated: {error}") from error

    @cached_property
    def _tree(self) -> ast.expr:
        try:
            return ast.parse(self.text.strip(), mode="eval").body
        except SyntaxError as error:
            raise InvalidInput(f"'{self.text}' is no comparison: {error.msg}") from error
        except (RecursionError, MemoryError) as error:  # of Python's parser
            raise InvalidInput(self._too_long()) from error

    def _too_long(self) -> str:
        start = self.text if len(self.text) <= SHOWN else f"{self.text[:SHOWN]}.."
        return f"'{start}' has more than {DEEPEST} operations inside each other; use several"


def _depth(tree: ast.AST) -> int:
    """How many nodes lie inside each other, counted without recursion."""
    depth, level = 0, [tree]
    while level:
        depth, level = depth + 1, [child for node in level for child in ast.iter_child_nodes(node)]
    return depth


def _is_known(node: ast.AST) -> bool:
    kinds = (ast.Compare, ast.BoolOp, ast.And, ast.Or, ast.BinOp, ast.UnaryOp, ast.Load)
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float | str)
    return isinstance(node, (*kinds, *_NAMES)) or type(node) in {**_ARITHMETIC, **_COMPARISONS}


def _names_in(node: ast.AST) -> list[str]:
    if isinstance(node, _NAMES):
        return [ast.unparse(node)]
    return [name for child in ast.iter_child_nodes(node) for name in _names_in(child)]


class _Renamed(ast.NodeTransformer):
    """Replaces the names of settings by other names."""

    def __init__(self, names: Mapping[str, str]) -> None:
        self._names = names

    def visit(self, node: ast.AST) -> ast.AST:
        """The node, or the name that takes its place."""
        if isinstance(node, _NAMES):
            name = ast.unparse(node)
            return ast.parse(self._names.get(name, name), mode="eval").body
        return super().generic_visit(node)


def _value(node: ast.AST, settings: Mapping[str, object]) -> Any:
    match node:
        case ast.Constant(value=value):
            return value
        case ast.BoolOp(op=op, values=values):
            together = all if isinstance(op, ast.And) else any
            return together(_value(value, settings) for value in values)
        case ast.UnaryOp(op=op, operand=operand):
            return _ARITHMETIC[type(op)](_value(operand, settings))
        case ast.BinOp(left=left, op=op, right=right):
            return _ARITHMETIC[type(op)](_value(left, settings), _value(right, settings))
        case ast.Compare(left=left, ops=ops, comparators=comparators):
            values = [_value(entry, settings) for entry in (left, *comparators)]
            pairs = zip(ops, values, values[1:], strict=False)
            return all(_COMPARISONS[type(op)](a, b) for op, a, b in pairs)
        case _:
            return settings[ast.unparse(node)]
