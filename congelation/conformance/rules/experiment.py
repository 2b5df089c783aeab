"""Rules about fmi2SetupExperiment (section 2.1.6): start time, stop time, tolerance."""

from __future__ import annotations

from collections.abc import Iterator

from congelation.conformance.bench import Bench
from congelation.conformance.binding import Status
from congelation.conformance.instance import Instance
from congelation.conformance.rule import Rule, dynamic
from congelation.conformance.trajectory import Grid, demand, excite, simulate

__all__ = ["RULES"]

# A start time that no FMU has by default, exactly representable, and larger than any step.
_LATER = 64.0
_REFUSALS = (Status.DISCARD, Status.ERROR)


def _begun(
    bench: Bench, start: float, stop: float | None = None, tolerance: float | None = None
) -> Instance:
    """A new instance, initialized for an experiment."""
    instance = bench.fresh()
    demand(
        instance.setup(start, stop, tolerance),
        f"fmi2SetupExperiment(start {start:g}, stop {stop}, tolerance {tolerance})",
    )
    demand(instance.enter(), "fmi2EnterInitializationMode")
    excite(instance, bench.description, 0)
    demand(instance.leave(), "fmi2ExitInitializationMode")
    return instance


@dynamic("FMI2-EXP-01", "2.1.6")
def start_time(bench: Bench) -> Iterator[str]:
    """An experiment may start at another time than 0, and the independent variable is that time."""
    later = bench.grid.start + _LATER
    instance = _begun(bench, later)
    for v in bench.description.variables:
        if v.causality == "independent":
            _, (time,) = instance.get("Real", [v.reference])
            if time != later:
                yield f"{v.name} is {time} after initialization at {later:g}"
    simulate(instance, bench.description, Grid(later, bench.grid.step))
    instance.free()


@dynamic("FMI2-EXP-02", "2.1.6")
def tolerance(bench: Bench) -> Iterator[str]:
    """A tolerance may be given, and the FMU runs with it."""
    for value in (1e-3, 1e-6):
        instance = _begun(bench, bench.grid.start, tolerance=value)
        bench.run(instance)
        instance.free()
    yield from ()


@dynamic("FMI2-EXP-03", "2.1.6")
def stop_time(bench: Bench) -> Iterator[str]:
    """A stop time may be given, and what happens before it does not depend on it."""
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
    status = instance.step(grid.time(2), grid.step)
    if status != Status.FATAL:
        instance.free()
    return status


@dynamic("FMI2-EXP-04", "2.1.6")
def past_stop_refused(bench: Bench) -> Iterator[str]:
    """A step past the stop time is refused."""
    status = _past_stop(bench)
    if status not in _REFUSALS:
        yield f"fmi2DoStep past stopTime returned {status}"


@dynamic("FMI2-EXP-05", "2.1.6")
def past_stop_is_error(bench: Bench) -> Iterator[str]:
    """A step past the stop time returns fmi2Error."""
    status = _past_stop(bench)
    if status != Status.ERROR:
        yield f"fmi2DoStep past stopTime returned {status}"


@dynamic("FMI2-EXP-06", "2.1.6")
def up_to_stop(bench: Bench) -> Iterator[str]:
    """A step that ends exactly at the stop time succeeds."""
    # Powers of two add up without rounding, so that "exactly" needs no tolerance.
    step, steps = 2.0**-7, 8
    instance = _begun(bench, 0.0, steps * step)
    simulate(instance, bench.description, Grid(0.0, step, steps))
    instance.free()
    yield from ()


@dynamic("FMI2-EXP-07", "2.1.6")
def last_setup_counts(bench: Bench) -> Iterator[str]:
    """fmi2SetupExperiment may be called again before initialization; the last call counts."""
    grid = bench.grid
    instance = bench.fresh()
    demand(instance.setup(grid.start + _LATER, grid.start + 2 * _LATER), "fmi2SetupExperiment")
    found = bench.run(bench.initialize(instance))
    instance.free()
    yield from bench.compare(found, "after a second fmi2SetupExperiment")


RULES: tuple[Rule, ...] = (
    start_time,
    tolerance,
    stop_time,
    past_stop_refused,
    past_stop_is_error,
    up_to_stop,
    last_setup_counts,
)
