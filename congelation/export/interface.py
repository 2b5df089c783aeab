"""The variables of an FMU, derived from a model: names, types, start values, dependencies.

The order of the table is what the generated equations, the slave at run time and
modelDescription.xml agree on: a variable's place in it is its value reference.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from congelation.fmi.units import factors, unit_of_factors
from congelation.signals import FlatParameter, Profile, Slots, flat_parameters
from congelation.theory.model import Domain, Model, Parameter, State, Variables

__all__ = [
    "Interface",
    "ProfileSlots",
    "ScalarVariable",
    "Start",
    "StateVariable",
    "delays",
    "interface_of",
    "native_parameters",
    "profiled_names",
    "start_names",
    "state_variables",
]

# Inputs take a value and derivatives up to this order: a cubic over the communication step.
HIGHEST_ORDER = 3

Start = float | int | bool | str


# What follows from the causality: variability and initial.
_NATURES: Mapping[str, tuple[str, str | None]] = {
    "input": ("continuous", None),
    "output": ("continuous", "calculated"),
    "local": ("continuous", "calculated"),
    "parameter": ("fixed", "exact"),
    "calculatedParameter": ("fixed", "calculated"),
}


@dataclass(frozen=True)
class ScalarVariable:
    """One row of the table.

    `depends` names the variables that an output or calculated parameter depends on: inputs at
    every communication point, parameters besides at initialisation. `open` marks inputs that are
    meant to be left unconnected, unless a tool knows what they are for.
    """

    name: str
    causality: str
    description: str
    unit: str = ""
    depends: frozenset[str] = frozenset()
    start: Start | None = None
    type: str = "Real"
    open: bool = False

    @property
    def variability(self) -> str:
        """That of FMI."""
        return _NATURES[self.causality][0]

    @property
    def initial(self) -> str | None:
        """That of FMI."""
        return _NATURES[self.causality][1]


# A parameter of native FMUs with profiles, behind all other variables. Python FMUs have it not, as
# pythonfmu cannot tell the last successful time.
_LEAVE_AT_JUMPS = ScalarVariable(
    "leave_at_jumps",
    "parameter",
    "Whether fmi2DoStep ends at a jump inside the step: it returns fmi2Discard, and "
    "fmi2LastSuccessfulTime is the time of the jump",
    start=False,
    type="Boolean",
)


# Another one, of a delay; what the Python FMU can hold is not set.
_CAPACITY = ScalarVariable(
    "capacity",
    "parameter",
    "How many steps are remembered at most",
    start=100_000,
    type="Integer",
)


@dataclass(frozen=True)
class Interface:
    """All variables of an FMU, and the part that each of them plays.

    Everything but `variables` holds value references, in the order in which the equations take
    or return the values. `inputs` begins with the inputs proper, then their derivatives of order
    1, 2 and 3, then dtheta; `parameters` and `profiles` are by name.
    """

    variables: tuple[ScalarVariable, ...]
    inputs: tuple[int, ...]
    dtheta: tuple[int, ...]
    outputs: tuple[int, ...]
    theta: tuple[int, ...]
    next_event: tuple[int, ...]
    derivatives: tuple[int, ...]
    gains: tuple[int, ...]
    parameters: Mapping[str, tuple[int, ...]]
    starts: tuple[int, ...]
    profiles: Mapping[str, Mapping[str, int]]


def start_names(state: State, plant: bool) -> tuple[str, ...]:
    """Names of the parameters that hold the start values of a state.

    A plant's are x0[i] even where its state is the scalar x.
    """
    name = state.variables.name
    if plant and not state.variables.indexed:
        return (f"{name}0[1]",)
    return tuple(n.replace(name, f"{name}0", 1) for n in state.variables.names)


@dataclass(frozen=True)
class ProfileSlots:
    """The default profile of one component of theta or of one signal, and the room for others."""

    profile: Profile
    slots: Slots

    @property
    def parameters(self) -> list[FlatParameter]:
        return flat_parameters(self.slots)


def interface_of(model: Model, profiles: Sequence[ProfileSlots] = ()) -> Interface:
    """The interface of the FMU of `model`.

    Parameters
    ----------
    model : Model
        A plant (with theta), a block (maybe with signals) or a controller.
    profiles : sequence of ProfileSlots
        One for each component of theta, or for each signal.
    """
    rows: list[ScalarVariable] = []

    def add(group: Iterable[ScalarVariable]) -> tuple[int, ...]:
        first = len(rows)
        rows.extend(group)
        return tuple(range(first, len(rows)))

    plant = model.theta is not None
    causes = _Causes(model, profiles)
    inputs = add(_inputs(model))
    dtheta = add(_dtheta(model))
    outputs = add(_outputs(model, causes))
    theta = add(_theta(model, causes))
    next_event = add(_next_event(model, causes)) if model.driven else ()
    derivatives = add(_derivatives(model, causes))
    outputs += add(_locals(model))
    gains = add(_gains(model, causes))
    parameters = {p.variables.name: add(_parameter(p)) for p in model.parameters}
    starts = [vr for state in model.states for vr in add(_starts(state, plant))]
    fields = {
        f"profile[{j}]": dict(
            zip((row.name for row in p.parameters), add(_profile(j, name, p)), strict=True)
        )
        for j, (name, p) in enumerate(zip(profiled_names(model), profiles, strict=True), start=1)
    }
    return Interface(
        tuple(rows),
        inputs + dtheta,
        dtheta,
        outputs,
        theta,
        next_event,
        derivatives,
        gains,
        parameters,
        tuple(starts),
        fields,
    )


@dataclass(frozen=True)
class StateVariable:
    """A continuous state of model exchange: its value references, and its derivative's row.

    `derivative` is the row of the derivative, which is a new variable behind those of `interface`
    unless the state is an output with a ``der(.)``. `start` is the name of the start value.
    """

    reference: int
    derivative_reference: int
    derivative: ScalarVariable
    start: str


def native_parameters(model: Model, interface: Interface) -> tuple[ScalarVariable, ...]:
    """What native FMUs have besides, behind all other variables."""
    leaving = (_LEAVE_AT_JUMPS,) if interface.next_event else ()
    return (*leaving, _CAPACITY) if delays(model) else leaving


def delays(model: Model) -> bool:
    """Whether a model remembers its inputs."""
    return model.signals is not None and not model.signals.profiled


def state_variables(
    model: Model, profiles: Sequence[ProfileSlots], interface: Interface
) -> tuple[StateVariable, ...]:
    """The continuous states of a model, in the order in which its equations take them."""
    references = {v.name: vr for vr, v in enumerate(interface.variables)}
    causes = _Causes(model, profiles)
    plant = model.theta is not None
    found: list[StateVariable] = []
    behind = len(interface.variables)
    for state in model.states:
        v = state.variables
        rates = ca.vertsplit(ca.vec(state.rate))
        starts = start_names(state, plant)
        for name, unit, rate, start in zip(v.names, v.units, rates, starts, strict=True):
            about, cause = f"Time derivative of {name}", causes.behind(rate)
            row = ScalarVariable(f"der({name})", "local", about, _per_second(unit), cause)
            reference = references.get(row.name)
            if reference is None:
                reference, behind = behind, behind + 1
            else:
                row = interface.variables[reference]
            found.append(StateVariable(references[name], reference, row, start))
    return tuple(found)


def profiled_names(model: Model) -> tuple[str, ...]:
    """What the profiles of a model are of: ``theta[1]``, .. of a plant, ``r`` of a reference."""
    return () if model.profiled is None else model.profiled.names


class _Causes:
    """Which FMU variables stand behind the symbols of a model."""

    def __init__(self, model: Model, profiles: Sequence[ProfileSlots]) -> None:
        plant = model.theta is not None
        self.profiles = [
            frozenset(f"profile[{j}].{row.name}" for row in p.parameters)
            for j, p in enumerate(profiles, start=1)
        ]
        self.theta = [
            names | {f"dtheta[{j}]"} if plant else names
            for j, names in enumerate(self.profiles, start=1)
        ]
        self._symbols: list[ca.SX] = []
        self._names: list[frozenset[str]] = []
        for entry in model.inputs:
            self._note(entry.variables.elements, _singly(entry.variables.names))
            slopes = Variables("", entry.derivative, "").elements
            self._note(slopes, _singly(f"der({n})" for n in entry.variables.names))
        for state in model.states:
            self._note(state.variables.elements, _singly(start_names(state, plant)))
        elements_of = {p.variables.name: p.variables.names for p in model.parameters}
        for parameter in model.parameters:
            self._note(parameter.variables.elements, _singly(parameter.variables.names))
        if model.theta is not None:
            self._note(model.theta.elements, self.theta)
        if model.signals is not None:
            # What is remembered of inputs comes after their start; until then parameters say it.
            known = frozenset(n for p in model.parameters for n in p.variables.names)
            signals = model.signals.variables.elements
            behind = self.profiles if model.signals.profiled else [known] * len(signals)
            self._note(signals, behind)
            self._note(Variables("", model.signals.slopes, "").elements, behind)
        self.gains = {
            g.variables.name: frozenset(n for name in g.arguments for n in elements_of[name])
            for g in model.gains
        }
        for gain in model.gains:
            elements = gain.variables.elements
            self._note(elements, [self.gains[gain.variables.name]] * len(elements))

    def _note(self, symbols: Iterable[ca.SX], names: Iterable[frozenset[str]]) -> None:
        self._symbols += symbols
        self._names += names

    def behind(self, expression: ca.SX) -> frozenset[str]:
        """Names of the variables that a scalar expression depends on."""
        depends = ca.which_depends(expression, ca.vertcat(*self._symbols), 1, False)
        groups = [names for names, d in zip(self._names, depends, strict=True) if d]
        return frozenset[str]().union(*groups)


def _singly(names: Iterable[str]) -> list[frozenset[str]]:
    return [frozenset({name}) for name in names]


def _per_second(unit: str, order: int = 1) -> str:
    powers = factors(unit or "1")
    return unit_of_factors({**powers, "s": powers.get("s", 0) - order})


def _inputs(model: Model) -> Iterable[ScalarVariable]:
    proper = [
        (name, unit, entry)
        for entry in model.inputs
        for name, unit in zip(entry.variables.names, entry.variables.units, strict=True)
    ]
    for name, unit, entry in proper:
        disturbing = entry.source == "disturbance"  # 0 where nothing disturbs
        about = entry.variables.description
        yield ScalarVariable(name, "input", about, unit, start=0.0, open=disturbing)
    for order in range(1, HIGHEST_ORDER + 1):
        for name, unit, _ in proper:
            derivative = f"der({name})" if order == 1 else f"der({name},{order})"
            about = f"Derivative of order {order} of {name} at the communication point; 0: none"
            unit = _per_second(unit, order)
            yield ScalarVariable(derivative, "input", about, unit, start=0.0, open=True)


def _dtheta(model: Model) -> Iterable[ScalarVariable]:
    for j, unit in enumerate(() if model.theta is None else model.theta.units, start=1):
        about = f"Added to the profile of theta[{j}], held over a step"
        yield ScalarVariable(f"dtheta[{j}]", "input", about, unit, start=0.0, open=True)


def _outputs(model: Model, causes: _Causes) -> Iterable[ScalarVariable]:
    for output in model.outputs:
        v = output.variables
        for name, expression, unit in zip(v.names, v.elements, v.units, strict=True):
            yield ScalarVariable(name, "output", v.description, unit, causes.behind(expression))


def _derivatives(model: Model, causes: _Causes) -> Iterable[ScalarVariable]:
    for v in (output.variables for output in model.outputs if output.differentiated):
        for name, expression, unit in zip(v.names, v.elements, v.units, strict=True):
            about = f"Time derivative of {name}"
            depends = causes.behind(model.total_derivative(expression))
            yield ScalarVariable(f"der({name})", "output", about, _per_second(unit), depends)


def _theta(model: Model, causes: _Causes) -> Iterable[ScalarVariable]:
    if (v := model.theta) is not None:
        for name, unit, depends in zip(v.names, v.units, causes.theta, strict=True):
            yield ScalarVariable(name, "output", v.description, unit, depends)


def _next_event(model: Model, causes: _Causes) -> Iterable[ScalarVariable]:
    depends = frozenset[str]().union(*causes.profiles)
    if model.profiled is None:
        about = "Next time at which a jump of the input comes out; infinite if none does"
        known = [i.variables for i in model.inputs] + [p.variables for p in model.parameters]
        depends = frozenset(name for variables in known for name in variables.names)
    else:
        name = model.profiled.name
        about = f"Next time at which {name} or its slope jumps; infinite if it never does"
    yield ScalarVariable("next_event", "output", about, "s", depends)


def _locals(model: Model) -> Iterable[ScalarVariable]:
    """States that are not outputs: readable, so that nothing of the law is hidden."""
    shown = {output.variables.name for output in model.outputs}
    for v in (s.variables for s in model.states if s.variables.name not in shown):
        for name, unit in zip(v.names, v.units, strict=True):
            yield ScalarVariable(name, "local", v.description, unit)


def _gains(model: Model, causes: _Causes) -> Iterable[ScalarVariable]:
    for v in (gain.variables for gain in model.gains):
        depends = causes.gains[v.name]
        for name, unit in zip(v.names, v.units, strict=True):
            yield ScalarVariable(name, "calculatedParameter", v.description, unit, depends)


def _parameter(parameter: Parameter) -> Iterable[ScalarVariable]:
    v = parameter.variables
    kind, number = ("Boolean", bool) if parameter.domain is Domain.BOOLEAN else ("Real", float)
    for name, unit, default in zip(v.names, v.units, parameter.default, strict=True):
        start: Start = number(default)
        yield ScalarVariable(name, "parameter", v.description, unit, start=start, type=kind)


def _starts(state: State, plant: bool) -> Iterable[ScalarVariable]:
    v = state.variables
    names = start_names(state, plant)
    for start_name, name, unit, start in zip(names, v.names, v.units, state.start, strict=True):
        about = f"Start value of {name}"
        yield ScalarVariable(start_name, "parameter", about, unit, start=float(start))


def _profile(j: int, of: str, profile: ProfileSlots) -> Iterable[ScalarVariable]:
    starts = profile.profile.to_flat(profile.slots)
    for row in profile.parameters:
        name, about = f"profile[{j}].{row.name}", f"Profile of {of}: {row.description}"
        start = starts[row.name]
        yield ScalarVariable(name, "parameter", about, row.unit, start=start, type=row.type)
