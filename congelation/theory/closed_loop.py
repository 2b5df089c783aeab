"""A plant and its controller as one differential equation, the reference for any co-simulation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from congelation.errors import InvalidInput, amount, shown
from congelation.theory.model import Input, Model, Variables
from congelation.theory.values import complete_values

__all__ = ["ClosedLoop", "Compiled", "External", "SmoothPiece", "Solution", "Source", "close"]

Vector = NDArray[np.float64]


def close(
    plant: Model,
    controller: Model,
    parameters: Mapping[str, object] | None = None,
    sources: Sequence[Source] = (),
) -> ClosedLoop:
    """Connect every output to the input of its name, both ways.

    An input from outside of the loop, a reference or a disturbance, comes from the sources. One
    that none of them drives is left open and joins the states: a disturbance with the rate 0, of a
    reference and its derivatives each element with the next one and the last with 0.

    Parameters
    ----------
    plant, controller : Model
        The plant's outputs do not depend on its input, so there is no algebraic loop.
    parameters : mapping, optional
        Parameters of the controller, see `congelation.theory.values.complete_values`.
    sources : sequence of Source, optional
        What drives the inputs from outside.

    Raises
    ------
    InvalidInput
        If an input has no output of its name and shape, or comes from sources in part only.
    """
    timed = [source.model.signals for source in sources if source.model.signals is not None]
    blocks = [_numbered(source, timed[0].time if timed else None) for source in sources]
    offered: dict[str, ca.SX] = {}
    for source, block in zip(sources, blocks, strict=True):
        outputs = {
            name: element
            for y in block.outputs
            for name, element in zip(y.variables.names, y.variables.elements, strict=True)
        }
        links = {name: name for name in outputs} if source.links is None else source.links
        offered |= {name: outputs[output] for name, output in links.items()}
    driven: list[tuple[ca.SX, ca.SX]] = []
    external: list[External] = []
    for side, model in (("plant", plant), ("controller", controller)):
        for entry in model.inputs:
            v = entry.variables
            missing = [name for name in v.names if name not in offered]
            if entry.source == "loop":
                continue
            if not missing:
                driven.append((v.symbol, ca.vertcat(*(offered[name] for name in v.names))))
            elif len(missing) == len(v.names):
                external.append(External(side, entry))
            else:
                raise InvalidInput(
                    f"{', '.join(missing)} of the {side} has no source, while the rest of {v.name} "
                    "has one; give a source for each element"
                )

    # The plant's outputs into the law, the law's control into the plant.
    control = _connection(controller, plant)
    law = [*(s.rate for s in controller.states), *(y for _, y in control)]
    law += [o.variables.symbol for o in controller.outputs]
    fed = [*_connection(plant, controller), *driven]
    law = ca.substitute(law, [v for v, _ in fed], [y for _, y in fed])
    rates, rest = law[: len(controller.states)], law[len(controller.states) :]
    acting = [*((v, u) for (v, _), u in zip(control, rest, strict=False)), *driven]
    plant_rates = ca.substitute(
        [s.rate for s in plant.states], [v for v, _ in acting], [e for _, e in acting]
    )
    of_blocks = [s.rate for block in blocks for s in block.states]
    outputs_of_plant = [o.variables.symbol for o in plant.outputs]
    outputs_of_blocks = [o.variables.symbol for block in blocks for o in block.outputs]
    return ClosedLoop(
        plant=plant,
        controller=controller,
        values=complete_values(controller, parameters),
        rate=_stack([*plant_rates, *rates, *of_blocks, *(e.rate for e in external)]),
        output=_stack([*outputs_of_plant, *rest[len(control) :], *outputs_of_blocks]),
        external=tuple(external),
        sources=tuple(blocks),
    )


@dataclass(frozen=True)
class Source:
    """A block that drives inputs from outside of the loop.

    Attributes
    ----------
    model : Model
        A block without inputs.
    parameters : mapping, optional
        Its parameters.
    links : mapping of str to str, optional
        Elements of inputs, such as ``d[2]``, and the element of an output that each comes from;
        None: those of equal names.
    """

    model: Model
    parameters: Mapping[str, object] | None = None
    links: Mapping[str, str] | None = None


@dataclass(frozen=True)
class External:
    """An input from outside that no source drives, of the ``plant`` or the ``controller``."""

    side: str
    input: Input

    @property
    def variables(self) -> Variables:
        """The input's variables."""
        return self.input.variables

    @property
    def rate(self) -> ca.SX:
        """Its rate as a state of the loop."""
        symbol = self.variables.symbol
        if self.input.source == "reference":  # each derivative is the rate of the one before
            return ca.vertcat(symbol[1:], 0)
        return ca.SX.zeros(*symbol.shape)


def _numbered(source: Source, time: ca.SX | None) -> Model:
    """The block of a source with numbers for its parameters, and the symbol `time` for its time."""
    model = source.model
    given = complete_values(model, source.parameters)
    arguments = model.arguments()
    symbols = [arguments[name] for name in given]
    numbers = [ca.SX(ca.DM(value)) for value in given.values()]
    if model.signals is not None and time is not None:
        symbols, numbers = [*symbols, model.signals.time], [*numbers, time]
    expressions = [s.rate for s in model.states] + [y.variables.symbol for y in model.outputs]
    bound = ca.substitute(expressions, symbols, numbers)
    rates, outputs = bound[: len(model.states)], bound[len(model.states) :]
    return replace(
        model,
        states=tuple(replace(s, rate=r) for s, r in zip(model.states, rates, strict=True)),
        outputs=tuple(
            replace(y, variables=replace(y.variables, symbol=e))
            for y, e in zip(model.outputs, outputs, strict=True)
        ),
    )


@dataclass(frozen=True)
class SmoothPiece:
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
    external : tuple of External
        Open inputs; last in X.
    sources : tuple of Model
        What drives the others, with numbers for parameters; their states come behind those of the
        controller in X, their signals and the time last in theta.
    rate, output : casadi.SX
        Columns: f, and the outputs of the plant, then those of the controller.
    """

    plant: Model
    controller: Model
    values: Mapping[str, Vector]
    rate: ca.SX
    output: ca.SX
    external: tuple[External, ...] = ()
    sources: tuple[Model, ...] = ()

    @property
    def state_names(self) -> tuple[str, ...]:
        """``plant.x[1]``, .., ``controller.theta_hat[1]``, .., ``plant.d[1]``, .. ."""
        own = self._names(lambda model: [s.variables for s in model.states])
        return own + tuple(f"{e.side}.{name}" for e in self.external for name in e.variables.names)

    @property
    def output_names(self) -> tuple[str, ...]:
        """``plant.x[1]``, .., ``controller.u``, .. ."""
        return self._names(lambda model: [y.variables for y in model.outputs])

    def start(self, given: Mapping[str, ArrayLike] | None = None) -> Vector:
        """The start values of X, from the models' own where not `given` by name (``x``, ..)."""
        given = dict(given or {})
        states = [s for _, model in self._sides for s in model.states]
        starts = [(s.variables, s.start) for s in states]
        starts += [(e.variables, (0.0,) * len(e.variables.names)) for e in self.external]
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
        states += [e.variables.symbol for e in self.external]
        theta = ca.SX(0, 1) if self.plant.theta is None else self.plant.theta.symbol
        signals = [model.signals for model in self.sources if model.signals is not None]
        if signals:
            theta = ca.vertcat(theta, *(s.variables.symbol for s in signals), signals[0].time)
        return _stack(states), theta

    def opened(self, source: str) -> ca.SX:
        """The open inputs that are a ``reference``, or a ``disturbance``, as one column."""
        found = (e.variables.symbol for e in self.external if e.input.source == source)
        return ca.vertcat(ca.SX(0, 1), *found)

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
        segments: Sequence[SmoothPiece],
        start: Vector,
        times: ArrayLike,
        *,
        rtol: float = 1e-12,
        atol: float = 1e-12,
        method: str = "DOP853",
    ) -> Solution:
        """Integrate piece by piece, never across a jump of theta.

        Parameters
        ----------
        segments : sequence of SmoothPiece
            Each starts where the one before ends.
        start : ndarray
            X at the start of the first segment.
        times : array_like
            Increasing times to report; within the segments.
        rtol, atol, method
            As in `scipy.integrate.solve_ivp`. The tolerance is of the ends of steps; the values of
            DOP853 between them are of lower order, and at 1e-10 off by 2e-5 after a stiff start.
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
        """The blocks in the order in which X holds their states; sources as source1, .. ."""
        sources = [(f"source{k}", model) for k, model in enumerate(self.sources, start=1)]
        return [("plant", self.plant), ("controller", self.controller), *sources]


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


def _connection(source: Model, target: Model) -> list[tuple[ca.SX, ca.SX]]:
    """(input symbol, output expression) for every input of `target` from inside the loop."""
    outputs = {y.variables.name: y.variables for y in source.outputs}
    pairs = []
    for entry in target.inputs:
        name = entry.variables.name
        if entry.source != "loop":
            continue
        if name not in outputs or outputs[name].shape != entry.variables.shape:
            raise InvalidInput(
                f"{target.name} wants {amount(entry.variables.shape[:1])} of '{name}', which "
                f"{source.name} does not put out; close a plant with the controller of its form"
            )
        pairs.append((entry.variables.symbol, outputs[name].symbol))
    return pairs


def _start(variables: Variables, value: ArrayLike) -> Vector:
    column = np.asarray(value, dtype=float).ravel()
    size = len(variables.names)
    if column.size != size:
        raise InvalidInput(
            f"{variables.name} = {shown(column)} is not valid; give {amount((size,))}"
        )
    return column


def _stack(columns: Sequence[ca.SX]) -> ca.SX:
    """One dense column."""
    return ca.densify(ca.vertcat(*(ca.vec(c) for c in columns)))
