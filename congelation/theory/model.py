"""A plant or a controller as one symbolic block: x' = f(x, u, theta, p), y = h(x, u, p).

Everything the theory derives ends in a `Model`; everything that uses the theory (the FMU
export, the monolithic solution, the certificate, the tests) starts from one.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import casadi as ca
import numpy as np

from congelation.errors import InvalidInput, amount, nearest, shown

__all__ = [
    "Domain",
    "Gain",
    "Input",
    "Model",
    "Output",
    "Parameter",
    "Signals",
    "State",
    "Variables",
    "control",
    "matrix",
    "optional",
    "scalar",
    "vector",
]


class Domain(enum.Enum):
    """The values that a parameter may take; the value is the phrase used in messages."""

    REAL = "finite"
    POSITIVE = "positive"
    NONNEGATIVE = "non-negative"
    POSITIVE_DEFINITE = "a symmetric positive definite matrix"
    BOOLEAN = "true or false"
    SIGN = "+1 or -1"


@dataclass(frozen=True)
class Variables:
    """A named scalar, column vector or matrix of symbols.

    Parameters
    ----------
    name : str
        The symbol of the paper, spelt out: ``x``, ``theta_hat``, ``Gamma``.
    symbol : casadi.SX
        Shape (1, 1), (n, 1) or (n, m).
    description : str
        One line: what it is, with the number of its equation.
    unit : str or tuple of str
        One unit for all elements, or one each (row by row). Empty: dimensionless.
    indexed : bool
        False names a 1 x 1 symbol ``u``; True names its elements ``x[1]``, ``Gamma[1,2]``.
    first : int
        Index of the first element of a column: 1 as in the paper, 0 for derivatives.
    """

    name: str
    symbol: ca.SX
    description: str
    unit: str | tuple[str, ...] = ""
    indexed: bool = True
    first: int = 1

    @property
    def shape(self) -> tuple[int, int]:
        rows, columns = self.symbol.shape
        return int(rows), int(columns)

    @property
    def names(self) -> tuple[str, ...]:
        """Element names, row by row."""
        rows, columns = self.shape
        if not self.indexed:
            return (self.name,)
        if columns == 1:
            return tuple(f"{self.name}[{i + self.first}]" for i in range(rows))
        return tuple(f"{self.name}[{i + 1},{j + 1}]" for i in range(rows) for j in range(columns))

    @property
    def elements(self) -> tuple[ca.SX, ...]:
        """Element symbols, in the order of `names`."""
        rows, columns = self.shape
        return tuple(self.symbol[i, j] for i in range(rows) for j in range(columns))

    @property
    def units(self) -> tuple[str, ...]:
        """One unit per element, in the order of `names`."""
        return (self.unit,) * len(self.names) if isinstance(self.unit, str) else self.unit


def scalar(name: str, description: str, unit: str = "") -> Variables:
    """A scalar variable, named without an index."""
    return Variables(name, ca.SX.sym(name), description, unit, indexed=False)


def optional(wanted: bool, name: str, description: str, unit: str = "") -> Variables | None:
    """A scalar variable of a law, where its options want it."""
    return scalar(name, description, unit) if wanted else None


def vector(name: str, n: int, description: str, unit: str | tuple[str, ...] = "") -> Variables:
    """A column vector of n variables ``name[1] .. name[n]``."""
    return Variables(name, ca.SX.sym(name, n), description, unit)


def matrix(
    name: str, n: int, m: int, description: str, unit: str | tuple[str, ...] = ""
) -> Variables:
    """An n x m matrix of variables ``name[1,1] .. name[n,m]``."""
    symbol = ca.vertcat(
        *(ca.horzcat(*(ca.SX.sym(f"{name}_{i}_{j}") for j in range(m))) for i in range(n))
    )
    return Variables(name, symbol, description, unit)


@dataclass(frozen=True)
class Input:
    """An input and the symbol of its time derivative, which the co-simulation may supply.

    `source` says where it comes from: the other side of the ``loop``, or outside of it, a
    ``reference`` or a ``disturbance``. A disturbance may be left unconnected, and is 0 then.
    """

    variables: Variables
    derivative: ca.SX
    source: Literal["loop", "reference", "disturbance"] = "loop"

    @classmethod
    def of(
        cls, variables: Variables, source: Literal["loop", "reference", "disturbance"] = "loop"
    ) -> Input:
        return cls(variables, ca.SX.sym(f"der_{variables.name}", *variables.shape), source)


@dataclass(frozen=True)
class State:
    """A state, its rate of change, and the default of its start value ``<name>0``."""

    variables: Variables
    rate: ca.SX
    start: tuple[float, ...]


@dataclass(frozen=True)
class Parameter:
    """A constant that the user sets: default (row by row) and the values allowed."""

    variables: Variables
    default: tuple[float, ...]
    domain: Domain = Domain.REAL


@dataclass(frozen=True)
class Gain:
    """A constant computed from parameters by a numerical rule, e.g. a Riccati equation.

    Parameters
    ----------
    rule : str
        Name of the rule, one of ``congelation.theory.gains.RULES``.
    arguments : tuple of str
        Names of the parameters that the rule takes, in its order.
    constants : mapping
        Fixed data of the rule (orders, matrices as nested tuples).
    """

    variables: Variables
    rule: str
    arguments: tuple[str, ...]
    constants: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Output:
    """An output y = h(..); `differentiated` adds its exact time derivative ``der(name)``.

    `variables.symbol` holds the expression itself.
    """

    variables: Variables
    differentiated: bool = False


def control(u: ca.SX, description: str) -> Output:
    """The control of a law as an output."""
    return Output(Variables("u", ca.SX(u), description, indexed=False), differentiated=True)


@dataclass(frozen=True)
class Signals:
    """Functions of time that a block computes itself.

    Parameters
    ----------
    variables : Variables
        Their values.
    slopes : casadi.SX
        Their time derivatives between events, in the shape of the values.
    time : casadi.SX
        Time itself, for what a block computes from it directly.
    profiled : bool
        Whether they follow from profiles in its parameters, or from its inputs of the past.
    """

    variables: Variables
    slopes: ca.SX
    time: ca.SX
    profiled: bool = True

    @classmethod
    def of(cls, variables: Variables, profiled: bool = True) -> Signals:
        slopes = ca.SX.sym(f"der_{variables.name}", *variables.shape)
        return cls(variables, slopes, ca.SX.sym("time"), profiled)


@dataclass(frozen=True)
class Model:
    """A plant, a controller, or a block to put between the two.

    `theta` holds the unknown parameters theta(t) of a plant; `signals`, what a block computes as a
    function of time. A controller has neither; `Upsilon`, in its states, is what it takes for the
    known part of theta(t) = Upsilon vartheta + .., of which it estimates the constants vartheta.
    """

    name: str
    description: str
    inputs: tuple[Input, ...]
    states: tuple[State, ...]
    parameters: tuple[Parameter, ...]
    outputs: tuple[Output, ...]
    gains: tuple[Gain, ...] = ()
    theta: Variables | None = None
    signals: Signals | None = None
    Upsilon: ca.SX | None = None

    @property
    def profiled(self) -> Variables | None:
        """What follows from profiles: theta(t) of a plant, signals of a block."""
        if self.signals is None:
            return self.theta
        return self.signals.variables if self.signals.profiled else None

    @property
    def driven(self) -> bool:
        """Whether the equations take a function of time, which may jump."""
        return self.theta is not None or self.signals is not None

    def total_derivative(self, expression: ca.SX) -> ca.SX:
        """d/dt of an expression in the states, inputs and signals, by the chain rule."""
        moving = [(s.variables.symbol, s.rate) for s in self.states]
        moving += [(i.variables.symbol, i.derivative) for i in self.inputs]
        if self.signals is not None:
            moving.append((self.signals.variables.symbol, self.signals.slopes))
            moving.append((self.signals.time, ca.SX(1)))
        symbols = ca.vertcat(*(_column(symbol) for symbol, _ in moving))
        rates = ca.vertcat(*(_column(rate) for _, rate in moving))
        return ca.jtimes(expression, symbols, rates)  # one sweep for all of them

    def output(self, name: str) -> ca.SX:
        """The expression of the output `name`."""
        return next(y.variables.symbol for y in self.outputs if y.variables.name == name)

    def arguments(self) -> dict[str, ca.SX]:
        """Every free symbol by name: states, inputs, ``der(input)``, theta or signals and their
        slopes, time, parameters, gains."""
        named = {s.variables.name: s.variables.symbol for s in self.states}
        named |= {i.variables.name: i.variables.symbol for i in self.inputs}
        named |= {f"der({i.variables.name})": i.derivative for i in self.inputs}
        if self.theta is not None:
            named[self.theta.name] = self.theta.symbol
        if self.signals is not None:
            v = self.signals.variables
            named |= {v.name: v.symbol, f"der({v.name})": self.signals.slopes}
            named["time"] = self.signals.time
        named |= {p.variables.name: p.variables.symbol for p in self.parameters}
        named |= {g.variables.name: g.variables.symbol for g in self.gains}
        return named

    def defaults(self) -> dict[str, np.ndarray]:
        """The default of every parameter, in its shape."""
        return {
            p.variables.name: np.array(p.default, dtype=float).reshape(p.variables.shape)
            for p in self.parameters
        }

    def with_defaults(self, values: Mapping[str, object]) -> Model:
        """This model with other defaults, by the names of parameters and ``<state>0``.

        Raises
        ------
        InvalidInput
            If a name is unknown, or a value has the wrong shape.
        """
        known = {p.variables.name: p.variables.shape for p in self.parameters}
        known |= {f"{s.variables.name}0": s.variables.shape for s in self.states}
        given = {name: _shaped(name, value, known) for name, value in values.items()}
        parameters = tuple(
            replace(p, default=given.get(p.variables.name, p.default)) for p in self.parameters
        )
        states = tuple(
            replace(s, start=given.get(f"{s.variables.name}0", s.start)) for s in self.states
        )
        return replace(self, parameters=parameters, states=states)

    def with_units(self, units: Mapping[str, str | Sequence[str]]) -> Model:
        """This model with units for the variables of the given names; unknown names are ignored."""

        def measured(v: Variables) -> Variables:
            unit = units.get(v.name, v.unit)
            return replace(v, unit=unit if isinstance(unit, str) else tuple(unit))

        return replace(
            self,
            inputs=tuple(replace(i, variables=measured(i.variables)) for i in self.inputs),
            states=tuple(replace(s, variables=measured(s.variables)) for s in self.states),
            parameters=tuple(replace(p, variables=measured(p.variables)) for p in self.parameters),
            outputs=tuple(replace(y, variables=measured(y.variables)) for y in self.outputs),
            theta=None if self.theta is None else measured(self.theta),
            signals=None
            if self.signals is None
            else replace(self.signals, variables=measured(self.signals.variables)),
        )

    def evaluate(
        self, expressions: Sequence[ca.SX], values: Mapping[str, object]
    ) -> list[np.ndarray]:
        """The numbers of `expressions` where every symbol in `arguments` has a value, or 0."""
        named = self.arguments()
        function = ca.Function("evaluate", list(named.values()), list(expressions))
        numbers = [
            np.asarray(values.get(name, np.zeros(s.shape)), float).reshape(s.shape)
            for name, s in named.items()
        ]
        return [np.asarray(v) for v in function.call([ca.DM(x) for x in numbers])]


def _column(symbol: ca.SX) -> ca.SX:
    return ca.vec(symbol)


def _shaped(name: str, value: object, known: Mapping[str, tuple[int, int]]) -> tuple[float, ...]:
    """A value as numbers row by row, if `name` is known and the shape fits."""
    if name not in known:
        raise InvalidInput(f"{name} is not known; {nearest(name, known)}")
    rows, columns = known[name]
    try:
        numbers = np.asarray(value, dtype=float)
    except (OverflowError, TypeError, ValueError):
        raise InvalidInput(f"{name} = {shown(value)} is not valid; give numbers") from None
    shapes: set[tuple[int, ...]] = {(rows, columns)}
    if columns == 1:
        shapes.add((rows,))
    if rows == columns == 1:
        shapes.add(())
    if numbers.shape not in shapes or not np.isfinite(numbers).all():
        size = amount((rows,) if columns == 1 else (rows, columns))
        raise InvalidInput(f"{name} = {shown(value)} is not valid; give {size}")
    return tuple(float(v) for v in numbers.ravel())
