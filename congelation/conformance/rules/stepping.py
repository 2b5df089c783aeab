"""Rules about fmi2DoStep (sections 4.1 and 4.2.2)."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator

from congelation.conformance.bench import Bench
from congelation.conformance.binding import Status
from congelation.conformance.description import Value, Variable
from congelation.conformance.probe import read
from congelation.conformance.rule import Level, dynamic, require
from congelation.conformance.trajectory import Grid, demand, excite, inputs

__all__: list[str] = []

# A slave's own integrator has an error; what counts is that h and h/2 + h/2 end at the same place
# compared with the way gone. One percent is generous for an integrator and unreachable for a
# slave that ignores the size of the step.
_SPLIT_RELATIVE = 1e-2
_SPLIT_ABSOLUTE = 1e-6


def _continuous_outputs(bench: Bench) -> tuple[Variable, ...]:
    return tuple(
        v
        for v in bench.description.variables
        if v.causality == "output" and v.variability == "continuous"
    )


@dynamic("FMI2-STEP-01", "4.1.2, 4.2.2", Level.ROBUSTNESS)
def splitting(bench: Bench) -> Iterator[str]:
    """One step h ends where two steps h/2 end, under constant inputs, to the FMU's tolerance.

    Standard: "The slave must integrate until time instant tc + hc"; with which accuracy is not
    said.

    Why: A master with step size control compares h with h/2.

    Remedy: Integrate over the step that was asked for

    Example: An inner step of 10 ms, whatever h is.
    """
    bench.require_flag("canHandleVariableCommunicationStepSize")
    outputs = _continuous_outputs(bench)
    require(outputs, "there is no continuous output")
    step, worst = bench.grid.step, ""
    for size in (step, 4.0 * step):
        before, whole = _constant_inputs(bench, outputs, [size])
        _, halves = _constant_inputs(bench, outputs, [size / 2.0, size / 2.0])
        for v in outputs:
            way = abs(float(whole[v.index]) - float(before[v.index]))
            error = abs(float(whole[v.index]) - float(halves[v.index]))
            scale = max(1.0, abs(float(before[v.index])))
            if error > _SPLIT_RELATIVE * way + _SPLIT_ABSOLUTE * scale:
                worst = worst or (
                    f"{v.name} after h = {size:g} is {whole[v.index]!r}, "
                    f"after two steps h/2 {halves[v.index]!r}"
                )
    if worst:
        yield worst


def _constant_inputs(
    bench: Bench, outputs: tuple[Variable, ...], sizes: list[float]
) -> tuple[dict[int, Value], dict[int, Value]]:
    """Outputs before and after steps of the given sizes.

    Inputs that are derivatives of others are zero, or the others would not be constant.
    """
    slopes: dict[int, Value] = {
        v.index: 0.0
        for v in inputs(bench.description)
        if "derivative" in v.attributes or v.name.startswith("der(")
    }
    with bench.held() as instance:
        before = read(instance, outputs)
        time = bench.grid.start
        for size in sizes:
            excite(instance, bench.description, 0, instead=slopes)
            demand(instance.step(time, size), f"fmi2DoStep with h = {size:g}")
            time += size
        return before, read(instance, outputs)


@dynamic("FMI2-STEP-02", "4.2.2, 4.2.3", Level.VIOLATION)
def time_reached(bench: Bench) -> Iterator[str]:
    """After a step the FMU stands at currentCommunicationPoint + communicationStepSize.

    Standard: "The slave must integrate until time instant tc + hc"; the independent variable is
    set "by arguments currentCommunicationPoint and communicationStepSize of fmi2DoStep"

    Why: Outputs would belong to another time.

    Remedy: Set the independent variable to t + h at the end of a step

    Example: Time that stays behind by a step.
    """
    clocks = tuple(v for v in bench.description.variables if v.causality == "independent")
    require(clocks, "there is no independent variable")
    with bench.held() as instance:
        for point in range(3):
            bench.run(instance, first=point, last=point + 1, quiet=True)
            time = bench.grid.time(point)
            reached = time + (bench.grid.time(point + 1) - time)
            for v in clocks:
                if not _near(float(read(instance, (v,))[v.index]), reached, bench.grid.step):
                    yield f"{v.name} is {read(instance, (v,))[v.index]!r} at {reached!r}"


def _near(time: float, wanted: float, step: float) -> bool:
    """Equality up to the rounding of a sum of steps."""
    return abs(time - wanted) <= 1e-9 * step + 4.0 * math.ulp(abs(wanted))


def _accepted(bench: Bench, size: float) -> Iterator[str]:
    """A line if a step of a size that is none is not refused."""
    instance = bench.ready()
    bench.run(instance, last=1)
    excite(instance, bench.description, 1)
    status = instance.step(bench.grid.time(1), size)
    if status not in (Status.DISCARD, Status.ERROR):
        yield f"fmi2DoStep with h = {size:g} returned {status}"
    if status != Status.FATAL:
        demand(instance.reset(), f"fmi2Reset after a step h = {size:g}")
        found = bench.run(bench.initialize(instance))
        yield from bench.compare(found, f"after a step h = {size:g} and fmi2Reset")
        instance.free()


@dynamic("FMI2-STEP-03", "4.2.2", Level.ROBUSTNESS)
def positive_step(bench: Bench) -> Iterator[str]:
    """A step size of zero or less is refused.

    Standard: communicationStepSize "must be > 0.0": a demand on the host; what the FMU returns is
    not said.

    Why: A master's mistake should be seen.

    Remedy: Return fmi2Error for h <= 0

    Example: fmi2OK, and time runs backwards.
    """
    for size in (0.0, -bench.grid.step):
        yield from _accepted(bench, size)


@dynamic("FMI2-STEP-04", "4.2.2", Level.ROBUSTNESS)
def finite_step(bench: Bench) -> Iterator[str]:
    """A step size that is no number or infinite is refused.

    Standard: nothing; a host's mistake should be an error and no hang.

    Why: NaN comes out of a step size control that divides by zero.

    Remedy: Test with !(h > 0) or isfinite(h)

    Example: while (t < t_end) with t_end = inf.
    """
    for size in (math.nan, math.inf):
        yield from _accepted(bench, size)


@dynamic("FMI2-STEP-05", "4.2.2", Level.ROBUSTNESS)
def rounded_points(bench: Bench) -> Iterator[str]:
    """Communication points that differ from the FMU's own time by rounding are accepted.

    Standard: a note: currentCommunicationPoint "is present in order to handle a mismatch between
    the master and the FMU state of the slave".

    Why: Masters sum up steps in different ways.

    Remedy: Compare times with a tolerance

    Example: t != time as the test.
    """
    stop, steps = bench.description.experiment.stop, 100
    if stop is not None:
        # Towards the end of its experiment an FMU may want to terminate.
        steps = min(steps, int(0.5 * (stop - bench.grid.start) / bench.grid.step))
    products = Grid(bench.grid.start, bench.grid.step, steps)
    with bench.held() as instance:
        bench.run(instance, grid=products, quiet=True)
    with bench.held() as instance:
        # Always the same h, with points k h: the sum of the steps drifts away from them.
        for point in range(steps):
            excite(instance, bench.description, point)
            time = products.time(point)
            demand(instance.step(time, bench.grid.step), f"fmi2DoStep number {point + 1}")
    yield from ()


@dynamic("FMI2-STEP-06", "4.2.2", Level.ROBUSTNESS)
def flushing(bench: Bench) -> Iterator[str]:
    """noSetFMUStatePriorToCurrentPoint does not change the results.

    Standard: "the slave can use this flag to flush a result buffer" (a note).

    Why: Masters pass either value.

    Remedy: Use the flag for buffers only

    Example: Another integration method.
    """
    with bench.held() as instance:
        for point in range(bench.grid.steps):
            excite(instance, bench.description, point)
            time = bench.grid.time(point)
            size = bench.grid.time(point + 1) - time
            demand(instance.step(time, size, final=True), "fmi2DoStep")
        found = bench.run(instance, first=bench.grid.steps)
    yield from bench.compare(found, "with noSetFMUStatePriorToCurrentPoint")


@dynamic("FMI2-STEP-07", "4.1.2", Level.ROBUSTNESS)
def repeatable(bench: Bench) -> Iterator[str]:
    """Equal inputs give equal results, to the last bit, in every run.

    Standard: nothing; a host needs runs that can be repeated.

    Why: Without it no two runs can be compared.

    Remedy: Initialize all memory and seed random numbers

    Example: An uninitialized variable.
    """
    for _ in range(3):
        yield from bench.compare(bench.alone(), "a second run")


@dynamic("FMI2-STEP-08", "4.3.1", Level.VIOLATION)
def variable_steps(bench: Bench) -> Iterator[str]:
    """With canHandleVariableCommunicationStepSize the step size may change from step to step.

    Standard: canHandleVariableCommunicationStepSize: "The communication step size [..] has not to
    be constant for each call."

    Why: Step size control needs it.

    Remedy: Accept any step size, or set the flag to false

    Example: A step that is no multiple of the inner one is discarded.
    """
    bench.require_flag("canHandleVariableCommunicationStepSize")
    # Fixed seed: the same step sizes in every check.
    chance, time = random.Random(2), bench.grid.start
    stop = bench.description.experiment.stop
    # Twenty steps of up to three times the size, within the default experiment.
    unit = bench.grid.step
    if stop is not None and stop > time:
        unit = min(unit, (stop - time) / 60.0)
    with bench.held() as instance:
        for point in range(20):
            excite(instance, bench.description, point)
            size = unit * 10.0 ** chance.uniform(-1.0, 0.5)
            demand(instance.step(time, size), f"fmi2DoStep with h = {size:g}")
            time += size
    yield from ()


@dynamic(
    "FMI2-STEP-09", "4.3.1", Level.VIOLATION, needs="library", owns=("fmi2DoStep fmi2Pending",)
)
def synchronous(bench: Bench) -> Iterator[str]:
    """Without canRunAsynchronuously fmi2DoStep never returns fmi2Pending.

    Standard: fmi2Pending: "if the slave executes the function in an asynchronous way";
    canRunAsynchronuously "describes the ability"

    Why: A synchronous master does not wait.

    Remedy: Return when the step is done, or set the flag

    Example: fmi2Pending without the flag.
    """
    require(not bench.description.flag("canRunAsynchronuously"), "canRunAsynchronuously is true")
    with bench.held() as instance:
        for point in range(bench.grid.steps):
            excite(instance, bench.description, point)
            if instance.step(bench.grid.time(point), bench.grid.step) == Status.PENDING:
                yield "fmi2DoStep returned fmi2Pending"
                return
