"""Rules about model exchange (section 3): what its capability flags promise, and fmi2Reset."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from congelation.conformance.bench import Bench
from congelation.conformance.exchange import continuous, moved, numbers_of, settled, state_count
from congelation.conformance.probe import read
from congelation.conformance.rule import MODEL_EXCHANGE, Level, NotApplicable, dynamic
from congelation.conformance.trajectory import demand, excite, same

__all__: list[str] = []

# Difference quotients over such a step are good to a few digits.
_STEP = 1e-5
_ERROR = 1e-2


@dynamic("FMI2-ME-11", "2.1.9, 3.3.1", Level.VIOLATION, interface=MODEL_EXCHANGE)
def jacobian(bench: Bench) -> Iterator[str]:
    """With providesDirectionalDerivative the derivatives with respect to states are those
    measured.

    Standard: "fmi2GetDirectionalDerivative computes a linear combination of the partial
    derivatives"

    Why: Implicit solvers take their Jacobian from it.

    Remedy: Return the derivatives, or set the flag to false

    Example: 0 for every state.
    """
    count = state_count(bench)
    if not bench.description.exchange_flag("providesDirectionalDerivative"):
        raise NotApplicable("providesDirectionalDerivative is false")
    instance, _ = continuous(bench)
    x = moved(numbers_of(instance, "GetContinuousStates", count))
    unknowns = [derivative.reference for _, derivative in bench.description.state_vector]

    def rates(states: Sequence[float]) -> list[float]:
        demand(instance.set_states(states), "fmi2SetContinuousStates")
        return numbers_of(instance, "GetDerivatives", count)

    for i, (state, _) in enumerate(bench.description.state_vector):
        step = _STEP * (1.0 + abs(x[i]))
        high, low = (rates([*x[:i], x[i] + d, *x[i + 1 :]]) for d in (step, -step))
        demand(instance.set_states(x), "fmi2SetContinuousStates")
        status, found = instance.directional_derivative(unknowns, [state.reference], [1.0])
        demand(status, f"fmi2GetDirectionalDerivative with respect to {state.name}")
        for (_, v), a, b, value in zip(
            bench.description.state_vector, high, low, found, strict=True
        ):
            quotient = (a - b) / (2 * step)
            if not abs(value - quotient) <= _ERROR * (1.0 + abs(quotient)):
                yield f"d {v.name} / d {state.name} is {value!r}, measured {quotient!r}"
    instance.free()


@dynamic("FMI2-ME-12", "2.1.8, 3.3.1", Level.VIOLATION, interface=MODEL_EXCHANGE)
def state_holds(bench: Bench) -> Iterator[str]:
    """With canGetAndSetFMUstate of model exchange a state brings time, states and inputs back.

    Standard: "fmi2GetFMUstate makes a copy of the internal FMU state and returns a pointer to this
    copy"

    Why: A solver goes back over an event.

    Remedy: Copy all that a simulation needs to go on, or set the flag to false

    Example: The continuous states are left out.
    """
    if not bench.description.exchange_flag("canGetAndSetFMUstate"):
        raise NotApplicable("canGetAndSetFMUstate is false")
    count = state_count(bench)
    description = bench.description
    real = tuple(v for v in description.variables if v.base == "Real")
    instance, _ = continuous(bench)
    before = (numbers_of(instance, "GetDerivatives", count), read(instance, real))
    status, state = instance.get_state()
    demand(status, "fmi2GetFMUstate")
    demand(instance.set_time(bench.grid.time(1)), "fmi2SetTime")
    demand(
        instance.set_states(moved(numbers_of(instance, "GetContinuousStates", count))),
        "fmi2SetContinuousStates",
    )
    demand(instance.enter_event_mode(), "fmi2EnterEventMode")
    excite(instance, description, 1)
    settled(instance, bench.grid.time(1))
    demand(instance.set_state(state), "fmi2SetFMUstate")
    after = (numbers_of(instance, "GetDerivatives", count), read(instance, real))
    for v in real:
        if not same(before[1][v.index], after[1][v.index]):
            was, now = before[1][v.index], after[1][v.index]
            yield f"after fmi2SetFMUstate {v.name} is {now!r}, before {was!r}"
    if not all(map(same, before[0], after[0])):
        yield f"after fmi2SetFMUstate the derivatives are {after[0]}, before {before[0]}"
    # It went back to continuous-time mode, too.
    demand(instance.set_time(bench.grid.time(1)), "fmi2SetTime after fmi2SetFMUstate")
    demand(instance.free_state(state), "fmi2FreeFMUstate")
    instance.free()


@dynamic("FMI2-ME-13", "2.1.6", Level.VIOLATION, interface=MODEL_EXCHANGE)
def reset_is_new(bench: Bench) -> Iterator[str]:
    """After fmi2Reset a model exchange is as a new one.

    Standard: "The FMU goes into the same state as if fmi2Instantiate would have been called. All
    variables have their default values."

    Why: Sweeps reset in place of making a new instance.

    Remedy: Set every value back in fmi2Reset

    Example: A continuous state that survives.
    """
    count = state_count(bench)
    instance, _ = continuous(bench)
    x = numbers_of(instance, "GetContinuousStates", count)
    slopes = numbers_of(instance, "GetDerivatives", count)
    demand(instance.set_time(bench.grid.time(3)), "fmi2SetTime")
    demand(instance.set_states(moved(x)), "fmi2SetContinuousStates")
    demand(instance.reset(), "fmi2Reset in continuous-time mode")
    demand(instance.setup(bench.grid.start), "fmi2SetupExperiment after fmi2Reset")
    demand(instance.enter(), "fmi2EnterInitializationMode after fmi2Reset")
    excite(instance, bench.description, 0)
    demand(instance.leave(), "fmi2ExitInitializationMode after fmi2Reset")
    settled(instance, bench.grid.start)
    again = numbers_of(instance, "GetContinuousStates", count)
    for (v, _), one, other in zip(bench.description.state_vector, x, again, strict=True):
        if not same(one, other):
            yield f"after the reset {v.name} starts with {other!r} instead of {one!r}"
    if not all(map(same, slopes, numbers_of(instance, "GetDerivatives", count))):
        yield "after the reset the derivatives are other ones"
    instance.free()
