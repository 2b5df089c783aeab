"""Rules about fmi2SetupExperiment (section 2.1.6): start time, stop time, tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterator

from congelation.conformance.bench import Bench
from congelation.conformance.binding import Status
from congelation.conformance.instance import Instance
from congelation.conformance.rule import Level, NotApplicable, dynamic
from congelation.conformance.trajectory import Grid, demand, excite

__all__: list[str] = []

# A start time that no FMU has by default, exactly representable, and larger than any step.
_LATER = 64.0


def _begun(
    bench: Bench, start: float, stop: float | None = None, tolerance: float | None = None
) -> Instance:
    """A new instance, initialized for an experiment."""
    instance = bench.fresh()
    demand(
        instance.setup(start, stop, tolerance),
        f"fmi2SetupExperiment(start {start:g}, stop {stop}, tolerance {tolerance})",
    )
    return bench.initialize(instance, setup=False)


@dynamic("FMI2-EXP-01", "2.1.6", Level.VIOLATION)
def start_time(bench: Bench) -> Iterator[str]:
    """An experiment may start at another time than 0, and the independent variable is that time.

    Standard: "Argument startTime is the fixed initial value of the independent variable"

    Why: A run may continue another.

    Remedy: Take the time from startTime

    Example: Time = 0 in fmi2Instantiate and nowhere else.
    """
    later = bench.grid.start + _LATER
    instance = bench.fresh()
    if instance.setup(later) not in (Status.OK, Status.WARNING):
        # An FMU may check whether its model is valid there.
        raise NotApplicable(f"the FMU does not take the start time {later:g}")
    bench.initialize(instance, setup=False)
    for v in bench.description.variables:
        if v.causality == "independent":
            _, (time,) = instance.get("Real", [v.reference])
            if time != later:
                yield f"{v.name} is {time} after initialization at {later:g}"
    bench.run(instance, grid=Grid(later, bench.grid.step))
    instance.free()


@dynamic("FMI2-EXP-02", "2.1.6", Level.VIOLATION)
def tolerance(bench: Bench) -> Iterator[str]:
    """A tolerance may be given, and the FMU runs with it.

    Standard: an FMU "might ignore this argument", but the call with a tolerance is allowed

    Why: Masters with error control pass a tolerance.

    Remedy: Accept the tolerance, used or not

    Example: An error because toleranceDefined is true.
    """
    for value in (1e-3, 1e-6):
        instance = _begun(bench, bench.grid.start, tolerance=value)
        bench.run(instance)
        instance.free()
    yield from ()


@dynamic("FMI2-EXP-03", "2.1.6", Level.ROBUSTNESS)
def stop_time(bench: Bench) -> Iterator[str]:
    """A stop time may be given, and what happens before it does not depend on it.

    Standard: nothing; a host needs runs of different lengths to agree where they overlap.

    Why: A longer run repeats a shorter one.

    Remedy: Use stopTime to check and to allocate only

    Example: A profile that is stretched over the run.
    """
    grid = bench.grid
    for stop in (grid.time(grid.steps + 1), grid.time(1000 * grid.steps)):
        instance = _begun(bench, grid.start, stop)
        found = bench.run(instance)
        instance.free()
        yield from bench.compare(found, f"with stopTime = {stop:g}")


def _past_stop(bench: Bench) -> Status:
    """The status of a step beyond the stop time."""
    grid = bench.grid
    instance = _begun(bench, grid.start, grid.time(2))
    bench.run(instance, last=2)
    excite(instance, bench.description, 2)
    bench.library.probe = "past stopTime"
    status = instance.step(grid.time(2), grid.step)
    instance.free()
    return status


@dynamic("FMI2-EXP-04", "2.1.6", Level.VIOLATION)
def past_stop_refused(bench: Bench) -> Iterator[str]:
    """A step past the stop time returns fmi2Error.

    Standard: "if the environment tries to compute past stopTime the FMU has to return fmi2Status
    = fmi2Error"

    Why: Tables and logs may end there.

    Remedy: Compare t + h with stopTime and return fmi2Error

    Example: fmi2OK, or fmi2Discard.
    """
    status = _past_stop(bench)
    if status != Status.ERROR:
        yield f"fmi2DoStep past stopTime returned {status}"


@dynamic("FMI2-EXP-06", "2.1.6", Level.VIOLATION)
def up_to_stop(bench: Bench) -> Iterator[str]:
    """A step that ends exactly at the stop time succeeds.

    Standard: "The slave must integrate until time instant tc + hc"; only beyond stopTime an error
    is due

    Why: Every run ends with this step.

    Remedy: Compare with > and a few units of rounding

    Example: t + h >= stopTime as the test.
    """
    step, steps, start = bench.grid.step, 8, bench.grid.start
    if bench.description.flag("canHandleVariableCommunicationStepSize"):
        # Powers of two add up without rounding, so that "exactly" needs no tolerance.
        start, step = 0.0, 2.0 ** math.floor(math.log2(step))
    grid = Grid(start, step, steps)
    # Otherwise the FMU's own sum of steps may be off by its rounding.
    slack = 0.0 if start == 0.0 else steps * math.ulp(grid.time(steps))
    slack = slack or (0.0 if math.frexp(step)[0] == 0.5 else steps * math.ulp(grid.time(steps)))
    instance = _begun(bench, start, grid.time(steps) + slack)
    bench.run(instance, grid=grid)
    instance.free()
    yield from ()


@dynamic("FMI2-EXP-07", "2.1.6", Level.ROBUSTNESS)
def last_setup_counts(bench: Bench) -> Iterator[str]:
    """fmi2SetupExperiment may be called again before initialization; the last call counts.

    Standard: fmi2SetupExperiment "must be called at least once before calling
    fmi2EnterInitializationMode"; that the last call counts is not said.

    Why: Hosts repeat the call when the user changes the times.

    Remedy: Let the last call count

    Example: The first call's times are kept.
    """
    grid = bench.grid
    instance = bench.fresh()
    demand(instance.setup(grid.start + _LATER, grid.start + 2 * _LATER), "fmi2SetupExperiment")
    found = bench.run(bench.initialize(instance))
    instance.free()
    yield from bench.compare(found, "after a second fmi2SetupExperiment")
