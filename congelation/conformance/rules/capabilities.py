"""Rules about capability flags: what the XML promises, the FMU does (section 4.3.1)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from congelation.conformance.bench import Bench
from congelation.conformance.binding import Status
from congelation.conformance.description import Value, Variable
from congelation.conformance.probe import QUOTIENT_STEP, is_derivative, read
from congelation.conformance.rule import Level, NotApplicable, dynamic, require
from congelation.conformance.trajectory import demand, excitation, excite, inputs, same

__all__: list[str] = []

# How far a slope may be from the difference quotients about it, as a part of their distance.
_SLOPE_ERROR = 1e-2

_STATE = ("fmi2GetFMUstate", "fmi2SetFMUstate", "fmi2FreeFMUstate")
_BYTES = ("fmi2SerializedFMUstateSize", "fmi2SerializeFMUstate", "fmi2DeSerializeFMUstate")


def _real(variables: Sequence[Variable]) -> list[Variable]:
    return [v for v in variables if v.element == "Real" and v.variability == "continuous"]


@dynamic("FMI2-FLAG-01", "2.1.8, 4.3.1", Level.VIOLATION, owns=_STATE)
def state_functions(bench: Bench) -> Iterator[str]:
    """With canGetAndSetFMUstate the functions for the FMU state succeed.

    Standard: canGetAndSetFMUstate: "fmi2GetFMUstate, fmi2SetFMUstate, and fmi2FreeFMUstate are
    supported by the FMU"

    Why: Rollback needs it.

    Remedy: Implement the functions, or set the flag to false

    Example: fmi2Error from fmi2GetFMUstate.
    """
    bench.require_flag("canGetAndSetFMUstate")
    with bench.held() as instance:
        status, state = instance.get_state()
        demand(status, "fmi2GetFMUstate")
        demand(instance.set_state(state), "fmi2SetFMUstate")
        demand(instance.free_state(state), "fmi2FreeFMUstate")
    yield from ()


@dynamic("FMI2-FLAG-02", "2.1.8, 4.3.1", Level.VIOLATION, owns=_BYTES)
def serializing_functions(bench: Bench) -> Iterator[str]:
    """With canSerializeFMUstate the functions for serialized states succeed.

    Standard: canSerializeFMUstate: "fmi2SerializedFMUstateSize, fmi2SerializeFMUstate,
    fmi2DeSerializeFMUstate are supported by the FMU"

    Why: Checkpoints need it.

    Remedy: Implement the functions, or set the flag to false

    Example: fmi2Error from fmi2SerializeFMUstate.
    """
    bench.require_flag("canSerializeFMUstate")
    with bench.held() as instance:
        status, state = instance.get_state()
        demand(status, "fmi2GetFMUstate")
        status, size = instance.serialized_size(state)
        demand(status, "fmi2SerializedFMUstateSize")
        status, data = instance.serialize(state, size)
        demand(status, "fmi2SerializeFMUstate")
        status, _ = instance.deserialize(data)
        demand(status, "fmi2DeSerializeFMUstate")
    yield from ()


@dynamic("FMI2-FLAG-03", "4.2.1, 4.3.1", Level.VIOLATION)
def input_derivatives(bench: Bench) -> Iterator[str]:
    """With canInterpolateInputs fmi2SetRealInputDerivatives succeeds and has an effect.

    Standard: "Calling of fmi2SetRealInputDerivatives(..) has an effect for the slave."

    Why: Higher-order extrapolation needs it.

    Remedy: Use the derivatives, or set canInterpolateInputs to false

    Example: A function that returns fmi2OK and does nothing.
    """
    bench.require_flag("canInterpolateInputs")
    found = _real(inputs(bench.description))
    require(found, "there is no continuous Real input")
    references = [v.reference for v in found]
    results = []
    for slope in (0.0, 1.0):
        with bench.held() as instance:
            excite(instance, bench.description, 0)
            status = instance.set_input_derivatives(
                references, [1] * len(found), [slope] * len(found)
            )
            demand(status, "fmi2SetRealInputDerivatives")
            demand(instance.step(bench.grid.start, bench.grid.step), "fmi2DoStep")
            results.append(read(instance, bench.description.variables))
    if all(same(value, results[1][index]) for index, value in results[0].items()):
        yield "the derivatives of the inputs have no effect on a step"


@dynamic("FMI2-FLAG-04", "4.2.1, 4.3.1", Level.VIOLATION)
def output_derivatives(bench: Bench) -> Iterator[str]:
    """Output derivatives up to maxOutputDerivativeOrder can be read, the first being the slope
    or 0.

    Standard: "Calling of fmi2GetRealOutputDerivatives(..) is allowed up to the order defined by
    maxOutputDerivativeOrder"; it "retrieves the n-th derivative of output values"

    Why: Extrapolation of signals needs it.

    Remedy: Return the derivatives, or set maxOutputDerivativeOrder to 0

    Example: A constant in place of a slope.
    """
    order = bench.description.output_order
    found = _real([v for v in bench.description.variables if v.causality == "output"])
    if order < 1 or not found:
        raise NotApplicable("maxOutputDerivativeOrder is 0, or there is no continuous output")
    references = [v.reference for v in found]
    variable = bench.description.flag("canHandleVariableCommunicationStepSize")
    time, step = bench.grid.start, bench.grid.step
    size = QUOTIENT_STEP if variable else step
    with bench.held() as instance:
        begin = read(instance, tuple(found))
        excite(instance, bench.description, 0)
        demand(instance.step(time, step), "fmi2DoStep")
        before = read(instance, tuple(found))
        slopes: list[float] = []
        for k in range(1, order + 1):
            status, values = instance.get_output_derivatives(references, [k] * len(found))
            demand(status, f"fmi2GetRealOutputDerivatives of order {k}")
            slopes = slopes or values
        demand(instance.step(time + step, size), "fmi2DoStep")
        after = read(instance, tuple(found))
    for v, slope in zip(found, slopes, strict=True):
        past = (float(before[v.index]) - float(begin[v.index])) / step
        next_ = (float(after[v.index]) - float(before[v.index])) / size
        # The order of the FMU's approximation is its own affair: 0, or what lies about the
        # difference quotients of the step before and the step after.
        low, high = min(0.0, past, next_), max(0.0, past, next_)
        slack = high - low + _SLOPE_ERROR * (1.0 + high - low)
        if not low - slack <= slope <= high + slack:
            yield f"the derivative of {v.name} is {slope!r}, its slope {next_!r}"


@dynamic("FMI2-FLAG-05", "2.1.9, 4.3.1", Level.VIOLATION)
def directional_derivative(bench: Bench) -> Iterator[str]:
    """With providesDirectionalDerivative the partial derivatives are those measured.

    Standard: "fmi2GetDirectionalDerivative computes a linear combination of the partial
    derivatives"

    Why: Implicit masters solve loops with it.

    Remedy: Return the derivatives, or set the flag to false

    Example: A factor of two.
    """
    bench.require_flag("providesDirectionalDerivative")
    description = bench.description
    listed = [description.variable(unknown.index) for unknown in description.initial_unknowns]
    unknowns = _real([v for v in listed if v is not None])
    knowns = _real(inputs(description))
    if not unknowns or not knowns:
        raise NotApplicable("there is no Real unknown or no Real input")
    instance = bench.begin(bench.fresh())
    base = read(instance, tuple(unknowns))
    for known in knowns:
        excite(instance, description, 0)
        status, found = instance.directional_derivative(
            [v.reference for v in unknowns], [known.reference], [1.0]
        )
        demand(status, f"fmi2GetDirectionalDerivative with respect to {known.name}")
        moved: Value = float(excitation(known, 0)) + QUOTIENT_STEP
        excite(instance, description, 0, instead={known.index: moved})
        other = read(instance, tuple(unknowns))
        for v, derivative in zip(unknowns, found, strict=True):
            before, after = float(base[v.index]), float(other[v.index])
            # What stays infinite, such as the time of an event that never comes, does not change.
            quotient = 0.0 if same(before, after) else (after - before) / QUOTIENT_STEP
            if not is_derivative(derivative, quotient):
                yield f"d {v.name} / d {known.name} is {derivative!r}, measured {quotient!r}"
    instance.free()


@dynamic("FMI2-FLAG-06", "2.1.5, 4.3.1", Level.VIOLATION)
def no_memory_functions(bench: Bench) -> Iterator[str]:
    """With canNotUseMemoryManagementFunctions null pointers may stand for the memory functions.

    Standard: with canNotUseMemoryManagementFunctions "function allocateMemory is not used in the
    FMU and a void pointer can be provided"

    Why: Hosts pass null pointers.

    Remedy: Use malloc and free, or set the flag to false

    Example: functions->allocateMemory(1, n).
    """
    bench.require_flag("canNotUseMemoryManagementFunctions")
    instance = bench.initialize(bench.fresh(memory=False))
    found = bench.run(instance)
    instance.free()
    yield from bench.compare(found, "without memory functions")


@dynamic("FMI2-FLAG-07", "2.1.5, 4.3.1", Level.VIOLATION)
def several_instances(bench: Bench) -> Iterator[str]:
    """Without canBeInstantiatedOnlyOncePerProcess a second instance can be made.

    Standard: "An FMU can be instantiated many times (provided capability flag
    canBeInstantiatedOnlyOncePerProcess = false)."

    Why: A system may hold a model twice.

    Remedy: Allow it, or set canBeInstantiatedOnlyOncePerProcess

    Example: A null pointer for the second instance.
    """
    require(
        not bench.description.flag("canBeInstantiatedOnlyOncePerProcess"),
        "canBeInstantiatedOnlyOncePerProcess is true",
    )
    both = [bench.fresh(name, refusable=True) for name in ("first", "second")]
    for instance in both:
        if instance.component is None:
            yield f"the {instance.name} of two instances was refused"
    for instance in both:
        instance.free()


@dynamic("FMI2-FLAG-08", "4.2.1", Level.ROBUSTNESS)
def zeroth_derivative(bench: Bench) -> Iterator[str]:
    """The derivative of order 0 of an input cannot be set.

    Standard: "1 means the first derivative, 0 is not allowed": a demand on the host; what the FMU
    returns is not said.

    Why: A host's mistake should be seen.

    Remedy: Return fmi2Error for order 0

    Example: fmi2OK.
    """
    bench.require_flag("canInterpolateInputs")
    found = _real(inputs(bench.description))
    require(found, "there is no continuous Real input")
    with bench.held() as instance:
        bench.library.probe = "order 0"
        status = instance.set_input_derivatives([found[0].reference], [0], [1.0])
        if status in (Status.OK, Status.WARNING):
            yield f"fmi2SetRealInputDerivatives of order 0 returned {status}"
