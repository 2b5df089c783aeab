"""Rules about fmi2DoStep (sections 4.1 and 4.2.2)."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from ctypes import byref, c_double

from congelation.conformance.bench import Bench
from congelation.conformance.binding import Status
from congelation.conformance.description import Value, Variable
from congelation.conformance.instance import Instance
from congelation.conformance.probe import read
from congelation.conformance.rule import NotApplicable, Rule, dynamic
from congelation.conformance.trajectory import Grid, demand, excite, inputs, simulate

__all__ = ["RULES"]

_LAST_SUCCESSFUL_TIME = 2
# A slave's own integrator has an error; what counts is that h and h/2 + h/2 end at the same place
# compared with the way gone. One percent is generous for an integrator and unreachable for a
# slave that ignores the size of the step.
_SPLIT_RELATIVE = 1e-2
_SPLIT_ABSOLUTE = 1e-6


def _variable_steps(bench: Bench) -> None:
    if not bench.description.flag("canHandleVariableCommunicationStepSize"):
        raise NotApplicable("canHandleVariableCommunicationStepSize is false")


def _continuous_outputs(bench: Bench) -> tuple[Variable, ...]:
    return tuple(
        v
        for v in bench.description.variables
        if v.causality == "output" and v.variability == "continuous"
    )


@dynamic("FMI2-STEP-01", "4.1.2, 4.2.2")
def splitting(bench: Bench) -> Iterator[str]:
    """One step h ends where two steps h/2 end, under constant inputs, to the FMU's tolerance."""
    _variable_steps(bench)
    outputs = _continuous_outputs(bench)
    if not outputs:
        raise NotApplicable("there is no continuous output")
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


@dynamic("FMI2-STEP-02", "4.2.2, 4.2.3")
def time_reached(bench: Bench) -> Iterator[str]:
    """After a step the FMU stands at currentCommunicationPoint + communicationStepSize."""
    clocks = tuple(v for v in bench.description.variables if v.causality == "independent")
    with bench.held() as instance:
        for point in range(3):
            bench.run(instance, first=point, last=point + 1, quiet=True)
            time, end = bench.grid.time(point), c_double(math.nan)
            reached = time + (bench.grid.time(point + 1) - time)
            status = instance.call("GetRealStatus", _LAST_SUCCESSFUL_TIME, byref(end))
            if status == Status.OK and not _near(end.value, reached, bench.grid.step):
                yield f"fmi2LastSuccessfulTime is {end.value!r} at {reached!r}"
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


@dynamic("FMI2-STEP-03", "4.2.2")
def positive_step(bench: Bench) -> Iterator[str]:
    """A step size of zero or less is refused."""
    for size in (0.0, -bench.grid.step):
        yield from _accepted(bench, size)


@dynamic("FMI2-STEP-04", "4.2.2")
def finite_step(bench: Bench) -> Iterator[str]:
    """A step size that is no number or infinite is refused."""
    for size in (math.nan, math.inf):
        yield from _accepted(bench, size)


@dynamic("FMI2-STEP-05", "4.2.2")
def rounded_points(bench: Bench) -> Iterator[str]:
    """Communication points that differ from the FMU's own time by rounding are accepted."""
    stop, steps = bench.description.experiment.stop, 100
    if stop is not None:
        # Towards the end of its experiment an FMU may want to terminate.
        steps = min(steps, int(0.5 * (stop - bench.grid.start) / bench.grid.step))
    products = Grid(bench.grid.start, bench.grid.step, steps)
    with bench.held() as instance:
        simulate(instance, bench.description, products, quiet=True)
    with bench.held() as instance:
        # Always the same h, with points k h: the sum of the steps drifts away from them.
        for point in range(steps):
            excite(instance, bench.description, point)
            time = products.time(point)
            demand(instance.step(time, bench.grid.step), f"fmi2DoStep number {point + 1}")
    yield from ()


@dynamic("FMI2-STEP-06", "4.2.2")
def flushing(bench: Bench) -> Iterator[str]:
    """noSetFMUStatePriorToCurrentPoint does not change the results."""
    with bench.held() as instance:
        for point in range(bench.grid.steps):
            excite(instance, bench.description, point)
            time = bench.grid.time(point)
            size = bench.grid.time(point + 1) - time
            demand(instance.step(time, size, final=True), "fmi2DoStep")
        found = bench.run(instance, first=bench.grid.steps)
    yield from bench.compare(found, "with noSetFMUStatePriorToCurrentPoint")


@dynamic("FMI2-STEP-07", "4.1.2")
def repeatable(bench: Bench) -> Iterator[str]:
    """Equal inputs give equal results, to the last bit, in every run."""
    for _ in range(3):
        yield from bench.compare(bench.alone(), "a second run")


@dynamic("FMI2-STEP-08", "4.3.1")
def variable_steps(bench: Bench) -> Iterator[str]:
    """With canHandleVariableCommunicationStepSize the step size may change from step to step."""
    _variable_steps(bench)
    # Fixed seed: the same step sizes in every check.
    chance, time = random.Random(2), bench.grid.start
    with bench.held() as instance:
        for point in range(20):
            excite(instance, bench.description, point)
            size = bench.grid.step * 10.0 ** chance.uniform(-6.0, 0.0)
            demand(instance.step(time, size), f"fmi2DoStep with h = {size:g}")
            time += size
    yield from ()


@dynamic("FMI2-STEP-09", "4.3.1", bare=True)
def synchronous(bench: Bench) -> Iterator[str]:
    """Without canRunAsynchronuously fmi2DoStep never returns fmi2Pending."""
    if bench.description.flag("canRunAsynchronuously"):
        raise NotApplicable("canRunAsynchronuously is true")
    with bench.held() as instance:
        for point in range(bench.grid.steps):
            excite(instance, bench.description, point)
            if _pending(bench, instance, point):
                yield f"fmi2DoStep number {point + 1} returned fmi2Pending"


def _pending(bench: Bench, instance: Instance, point: int) -> bool:
    return instance.step(bench.grid.time(point), bench.grid.step) == Status.PENDING


RULES: tuple[Rule, ...] = (
    splitting,
    time_reached,
    positive_step,
    finite_step,
    rounded_points,
    flushing,
    repeatable,
    variable_steps,
    synchronous,
)
