"""A plant and its controller as one differential equation, the reference for any co-simulation."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from congelation.errors import InvalidInput
from congelation.theory.model import Model, Variables
from congelation.theory.values import complete_values

__all__ = ["ClosedLoop", "Compiled", "Segment", "Solution", "close"]

Vector = NDArray[np.float64]


def close(
    plant: Model,
    controller: Model,
    parameters: Mapping[str, object] | None = None,
    source: Model | None = None,
    source_parameters: Mapping[str, object] | None = None,
) -> ClosedLoop:
    """Connect every output to the input of its name, both ways.

    An input of the controller that holds a value and its derivatives, such as a reference, comes
    from the source. Without one it is left open and joins the states, each element's rate being
    the next one and that of the last 0.

    Parameters
    ----------
    plant, controller : Model
        The plant's outputs do not depend on its input, so there is no algebraic loop.
    parameters : mapping, optional
        Parameters of the controller, see `congelation.theory.values.complete_values`.
    source, source_parameters : Model, mapping, optional
        A block without inputs, and its parameters.

    Raises
    ------
    InvalidInput
        If an input has no output of its name and shape.
    """
    open_inputs = [i.variables for i in controller.inputs if i.variables.first == 0]
    external = () if source is not None else tuple(open_inputs)
    names = {v.name for v in open_inputs}
    sensed = _connection(plant, controller, names)
    driven: list[tuple[ca.SX, ca.SX]] = []
    source_rates: list[ca.SX] = []
    source_outputs: list[ca.SX] = []
    if source is not None:
        others = {i.variables.name for i in controller.inputs} - names
        driven = _connection(source, controller, others)
        given = complete_values(source, source_parameters)
        arguments = source.arguments()
        symbols = [arguments[name] for name in given]
        numbers = [ca.SX(ca.DM(value)) for value in given.values()]
        bound = ca.substitute(
            [
                *(e for _, e in driven),
                *(s.rate for s in source.states),
                *(y.variables.symbol for y in source.outputs),
            ],
            symbols,
            numbers,
        )
        ends = len(driven), len(driven) + len(source.states)
        driven = [(v, e) for (v, _), e in zip(driven, bound, strict=False)]
        source_rates, source_outputs = bound[ends[0] : ends[1]], bound[ends[1] :]
    control = _connection(controller, plant)
    expressions = [*(s.rate for s in controller.states), *(y for _, y in control)]
    expressions += [o.variables.symbol for o in controller.outputs]
    fed = [*sensed, *driven]
    expressions = ca.substitute(expressions, [v for v, _ in fed], [y for _, y in fed])
    rates, rest = expressions[: len(controller.states)], expressions[len(controller.states) :]
    inputs, outputs = rest[: len(control)], rest[len(control) :]
    plant_rates = ca.substitute([s.rate for s in plant.states], [v for v, _ in control], inputs)
    plant_outputs = [o.variables.symbol for o in plant.outputs]
    chains = [ca.vertcat(v.symbol[1:], 0) for v in external]
    return ClosedLoop(
        plant=plant,
        controller=controller,
        values=complete_values(controller, parameters),
        rate=_stack([*plant_rates, *rates, *source_rates, *chains]),
        output=_stack([*plant_outputs, *outputs, *source_outputs]),
        external=external,
        source=source,
    )


@dataclass(frozen=True)
class Segment:
    """theta(t) on an interval on which it is smooth.

    Parameters
    ----------
    start, end : float
        Seconds.
    theta : callable
        theta(t) of shape (p,) for start <= t <= end, where theta(end) is the limit from the left.
    """

    start: float
    end: float
    theta: Callable[[float], ArrayLike]


@dataclass(frozen=True)
class Solution:
    """What `ClosedLoop.solve` found, up to the end or to where the solver gave up.

    Attributes
    ----------
    time : ndarray, shape (N,)
    states, outputs : ndarray, shapes (N, number of states), (N, number of outputs)
        Columns as in `ClosedLoop.state_names` and `ClosedLoop.output_names`.
    success : bool
        Whether the last segment was solved to its end.
    message : str
        The solver's own.
    """

    time: Vector
    states: Vector
    outputs: Vector
    success: bool
    message: str


@dataclass(frozen=True)
class ClosedLoop:
    """X' = f(X, theta(t)), X holding the states of the plant, then those of the controller.

    Attributes
    ----------
    values : mapping
        The parameters and gains of the controller.
    external : tuple of Variables
        Open inputs of the controller, a value and its derivatives each; last in X.
    source : Model or None
        What drives them instead; its states are last in X, its signals and time last in theta.
    rate, output : casadi.SX
        Columns: f, and the outputs of the plant, then those of the controller.
    """

    plant: Model
    controller: Model
    values: Mapping[str, Vector]
    rate: ca.SX
    output: ca.SX
    external: tuple[Variables, ...] = ()
    source: Model | None = None

    @property
    def state_names(self) -> tuple[str, ...]:
        """``plant.x[1]``, .., ``controller.theta_hat[1]``, .. ."""
        own = self._names(lambda model: [s.variables for s in model.states])
        return own + tuple(f"controller.{name}" for v in self.external for name in v.names)

    @property
    def output_names(self) -> tuple[str, ...]:
        """``plant.x[1]``, .., ``controller.u``, .. ."""
        return self._names(lambda model: [y.variables for y in model.outputs])

    def start(self, given: Mapping[str, ArrayLike] | None = None) -> Vector:
        """The start values of X, from the models' own where not `given` by name (``x``, ..)."""
        given = dict(given or {})
        states = [s for _, model in self._sides for s in model.states]
        starts = [(s.variables, s.start) for s in states]
        starts += [(v, (0.0,) * len(v.names)) for v in self.external]
        unknown = set(given) - {v.name for v, _ in starts}
        if unknown:
            raise InvalidInput(f"no state is called '{min(unknown)}'")
        return np.concatenate([_start(v, given.get(v.name, start)) for v, start in starts])

    @cached_property
    def function(self) -> Compiled:
        """(X, theta) -> X', compiled to CasADi's virtual machine with the parameters put in."""
        return Compiled(self.bind([self.rate]), self.arguments)

    @cached_property
    def output_function(self) -> Compiled:
        """(X, theta) -> the outputs."""
        return Compiled(self.bind([self.output]), self.arguments)

    @property
    def arguments(self) -> tuple[ca.SX, ca.SX]:
        """The columns X and theta that every expression is a function of."""
        states = [s.variables.symbol for _, model in self._sides for s in model.states]
        states += [v.symbol for v in self.external]
        theta = ca.SX(0, 1) if self.plant.theta is None else self.plant.theta.symbol
        if self.source is not None and self.source.signals is not None:
            signals = self.source.signals
            theta = ca.vertcat(theta, signals.variables.symbol, signals.time)
        return _stack(states), theta

    def bind(self, expressions: Sequence[ca.SX]) -> list[ca.SX]:
        """`expressions` with the numbers of the parameters and gains put in."""
        named = self.controller.arguments()
        symbols = [named[name] for name in self.values]
        numbers = [ca.SX(ca.DM(value)) for value in self.values.values()]
        bound: list[ca.SX] = ca.substitute(list(expressions), symbols, numbers)
        return bound

    def state(self, side: str, name: str) -> Variables:
        """The state `name` of the ``plant`` or the ``controller``."""
        model = self.plant if side == "plant" else self.controller
        return next(s.variables for s in model.states if s.variables.name == name)

    def bound_signal(self, name: str) -> ca.SX:
        """The output ``plant.x``, ``controller.z``, .. as a column, with numbers for parameters."""
        rows = [k for k, full in enumerate(self.output_names) if full.split("[")[0] == name]
        (output,) = self.bind([self.output])
        return output[rows]

    def solve(
        self,
        segments: Sequence[Segment],
        start: Vector,
        times: ArrayLike,
        *,
        rtol: float = 1e-10,
        atol: float = 1e-10,
        method: str = "DOP853",
    ) -> Solution:
        """Integrate piece by piece, never across a jump of theta.

        Parameters
        ----------
        segments : sequence of Segment
            Each starts where the one before ends.
        start : ndarray
            X at the start of the first segment.
        times : array_like
            Increasing times to report; within the segments.
        rtol, atol, method
            As in `scipy.integrate.solve_ivp`.
        """
        wanted = np.asarray(times, dtype=float)
        if wanted.min() < segments[0].start or wanted.max() > segments[-1].end:
            raise InvalidInput(
                f"times from {wanted.min():.9g} to {wanted.max():.9g}; valid: within the segments, "
                f"{segments[0].start:.9g} to {segments[-1].end:.9g}"
            )
        X, rows, thetas = np.asarray(start, dtype=float), [], []
        success, message = True, ""
        for index, segment in enumerate(segments):
            last = index == len(segments) - 1
            before_end = wanted <= segment.end if last else wanted < segment.end
            inside = wanted[(wanted >= segment.start) & before_end]
            with np.errstate(all="ignore"):  # a trial step may overflow; the solver shortens it
                piece = scipy.integrate.solve_ivp(
                    lambda t, X, theta=segment.theta: self.function(X, theta(t)),
                    (segment.start, segment.end),
                    X,
                    method=method,
                    t_eval=np.union1d(inside, [segment.end]),
                    rtol=rtol,
                    atol=atol,
                )
            kept = np.isin(piece.t, inside)
            rows += list(piece.y.T[kept])
            thetas += [segment.theta(t) for t in piece.t[kept]]
            success, message = bool(piece.success), str(piece.message)
            if not success:
                break
            X = piece.y[:, -1]
        states = np.array(rows).reshape(len(rows), len(self.state_names))
        outputs = [self.output_function(X, theta) for X, theta in zip(rows, thetas, strict=True)]
        shape = (len(rows), len(self.output_names))
        return Solution(wanted[: len(rows)], states, np.reshape(outputs, shape), success, message)

    def _names(self, variables: Callable[[Model], Sequence[Variables]]) -> tuple[str, ...]:
        return tuple(
            f"{side}.{name}"
            for side, model in self._sides
            for v in variables(model)
            for name in v.names
        )

    @property
    def _sides(self) -> list[tuple[str, Model]]:
        """The blocks in the order in which X holds their states."""
        sides = [("plant", self.plant), ("controller", self.controller)]
        return sides if self.source is None else [*sides, ("source", self.source)]


class Compiled:
    """A fast function of numbers: some expressions, stacked into one vector.

    Evaluation goes through fixed buffers: a call costs a few microseconds, not the tens that
    converting to CasADi's matrices takes.

    Parameters
    ----------
    expressions : sequence of casadi.SX
    arguments : sequence of casadi.SX
        Columns of symbols.
    """

    def __init__(self, expressions: Sequence[ca.SX], arguments: Sequence[ca.SX]) -> None:
        stacked = ca.cse([_stack(expressions)])
        function = ca.Function("compiled", list(arguments), stacked)
        self._arguments = [np.zeros(int(a.numel())) for a in arguments]
        self._result = np.zeros(int(stacked[0].numel()))
        # The evaluation reads memory that the buffer object owns: it has to live as long.
        self._buffer, self._evaluate = function.buffer()
        for index, entry in enumerate(self._arguments):
            self._buffer.set_arg(index, entry.data)  # type: ignore[call-arg]  # stub wants the size
        self._buffer.set_res(0, self._result.data)  # type: ignore[call-arg]  # as above

    def __call__(self, *values: ArrayLike) -> Vector:
        """The expressions at these values of the arguments."""
        for entry, value in zip(self._arguments, values, strict=True):
            entry[:] = value
        self._evaluate()
        return self._result.copy()


def _connection(
    source: Model, target: Model, apart: Collection[str] = ()
) -> list[tuple[ca.SX, ca.SX]]:
    """(input symbol, output expression) for every input of `target`, but those `apart`."""
    outputs = {y.variables.name: y.variables for y in source.outputs}
    pairs = []
    for entry in target.inputs:
        name = entry.variables.name
        if name in apart:
            continue
        rows = entry.variables.shape[0]
        # Of a value and its derivatives, a source may have more than are asked for.
        more = name in outputs and outputs[name].first == 0 and outputs[name].shape[0] > rows
        if more:
            pairs.append((entry.variables.symbol, outputs[name].symbol[:rows]))
            continue
        if name not in outputs or outputs[name].shape != entry.variables.shape:
            raise InvalidInput(
                f"{target.name} wants '{name}' of {rows} elements, which "
                f"{source.name} does not put out; close a plant with the controller of its form"
            )
        pairs.append((entry.variables.symbol, outputs[name].symbol))
    return pairs


def _start(variables: Variables, value: ArrayLike) -> Vector:
    column = np.asarray(value, dtype=float).ravel()
    size = len(variables.names)
    if column.size != size:
        raise InvalidInput(f"{variables.name} has {column.size} elements; valid: {size}")
    return column


def _stack(columns: Sequence[ca.SX]) -> ca.SX:
    """One dense column."""
    return ca.densify(ca.vertcat(*(ca.vec(c) for c in columns)))
