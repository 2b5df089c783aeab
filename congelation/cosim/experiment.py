"""What to do with a system: times, steps, coupling, and what is kept."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from congelation.arguments import check_fields
from congelation.cosim.coupling import (
    Auto,
    Coupling,
    Derivative,
    Hermite,
    ModelExchange,
    make_coupling,
    refuse_tolerance,
)
from congelation.cosim.recording import Output
from congelation.cosim.system import ResolvedSystem
from congelation.errors import InvalidInput, require_count, shown

__all__ = [
    "Experiment",
    "refuse_too_many_rows",
    "require_abilities",
    "require_resolved_periods",
    "slave_tolerance",
    "step_count",
]

SLAVE_SHARE = 0.1
"""Tolerance of the FMUs' own integration, relative to the tolerance of the run."""

RESOLVED = 16.0
"""Shortest period that time resolves, in units in the last place of the time."""

MOST_POINTS = 1e12
"""Largest number of points of one kind in a run: so many take months."""

MOST_ROWS = 1e8
"""Rows of a run: each takes 8 bytes a column."""

GRID_ROUNDING = 1e-12
"""A horizon this near to a whole number of steps, relative, is taken to be one."""


UNITS = 2.0
"""The same, in units in the last place of the time: start and stop are off by so much when they are
written as decimal numbers."""

GRID_SHARE = 1e-3
"""Largest part of a step that counts as rounding."""


SMALLEST_TOLERANCE = 1e-15
"""No smaller one is taken: rounding errors are larger."""

_NUMBERS = ("start_time", "stop_time", "step", "tolerance", "slave_tolerance", "output_interval")


@dataclass(frozen=True)
class Experiment:
    """One run of a system, as plain data.

    Parameters
    ----------
    stop_time : float
        Seconds. The last step is shortened to end there exactly.
    record : tuple of str, optional
        Names ``component.variable``; a vector's name stands for its elements. None: every number
        among the outputs, der(.) and next_event left out.
    start_time : float
        Seconds.
    step : float, optional
        Communication step h in seconds: communication points are t_0 + k h. With a tolerance it is
        the first step that is tried.
    tolerance : float, optional
        Steps are chosen so that, while an FMU steps, each of its inputs stays this near to the
        output that drives it, relative to the output's nominal value plus its size.
    coupling : str or Coupling
        How inputs move between communication points: a name in
        `congelation.cosim.coupling.COUPLINGS`, or an instance. "auto" stands for the most accurate
        one that the FMUs allow.
    options : mapping
        Options of a coupling given by its name.
    slave_tolerance : float, optional
        Relative tolerance of the integration inside the FMUs (fmi2SetupExperiment). None: a tenth
        of `tolerance`, and without one that of the FMUs.
    output_interval : float, optional
        Seconds between recorded rows, whatever the steps; else every communication point is one.
    output_every : int, optional
        Every how many communication points a row is recorded; not with an interval.
    max_steps : int, optional
        The run ends after so many steps, those taken back included.

    Raises
    ------
    InvalidInput
        Times, steps or tolerances that no run can have, an unknown coupling, an option that the
        coupling does not have. That the coupling takes the tolerance is checked when the experiment
        is performed: of two variants that change both, each alone need not fit.

    Examples
    --------
    >>> cg.Experiment(stop_time=2.0, coupling="hermite", tolerance=1e-6).tolerance
    1e-06
    """

    stop_time: float
    record: tuple[str, ...] | None = None
    start_time: float = 0.0
    step: float | None = None
    tolerance: float | None = None
    coupling: str | Coupling | Auto = Auto.name
    options: Mapping[str, object] = field(default_factory=dict)
    slave_tolerance: float | None = None
    output_interval: float | None = None
    output_every: int | None = None
    max_steps: int | None = None

    def __post_init__(self) -> None:
        check_fields(self, "")
        for name in _NUMBERS:
            value = getattr(self, name)
            if value is not None and not _is_float(value):
                raise InvalidInput(f"{name} = {shown(value)} is not valid; give a finite number")
        start, stop = self.start_time, self.stop_time
        if not (math.isfinite(stop - start) and stop > start):
            raise InvalidInput(f"stop_time {stop:g} must be finite and after start_time {start:g}")
        if self.step is None and self.tolerance is None:
            raise InvalidInput("give a communication step or a tolerance")
        if self.tolerance is not None and not SMALLEST_TOLERANCE <= self.tolerance < 1.0:
            raise InvalidInput(
                f"tolerance {self.tolerance:g} must lie between 0 and 1, and be "
                f"{SMALLEST_TOLERANCE:g} at least"
            )
        if self.slave_tolerance is not None and not self.slave_tolerance > 0.0:
            raise InvalidInput(f"slave_tolerance {self.slave_tolerance:g} must be positive")
        for name in ("output_every", "max_steps"):
            if getattr(self, name) is not None:
                require_count(getattr(self, name), name)
        if self.options and not isinstance(self.coupling, str):
            raise InvalidInput(
                "options go with the name of a coupling; this one has its own already"
            )
        self.given_coupling  # noqa: B018  # refuses what is unknown
        if self.slave_tolerance is not None and self.slave_tolerance <= 0.0:
            raise InvalidInput(f"slave_tolerance {self.slave_tolerance:g} must be positive")

    @cached_property
    def given_coupling(self) -> Coupling | Auto:
        """The coupling itself, or what stands for one that is still to be found.

        Raises
        ------
        InvalidInput
            An unknown name or option.
        """
        if isinstance(self.coupling, str):
            return make_coupling(self.coupling, self.options)
        return self.coupling

    @property
    def chosen_coupling(self) -> Coupling:
        """The coupling itself.

        Raises
        ------
        InvalidInput
            It is still to be found.
        """
        coupling = self.given_coupling
        if isinstance(coupling, Auto):
            raise InvalidInput(
                f"coupling '{coupling.name}' stands for another one, which simulate and perform "
                "find; give that one"
            )
        return coupling

    @property
    def periods(self) -> Mapping[str, float]:
        """Times between points that the coupling adds of its own, in seconds, by option."""
        coupling = self.given_coupling
        return {} if isinstance(coupling, Auto) else coupling.periods

    @property
    def output(self) -> Output | None:
        """What to record, where it is not every communication point."""
        if self.output_interval is not None:
            return Output(interval=self.output_interval)
        return None if self.output_every is None else Output(every=self.output_every)


def _is_float(number: float) -> bool:
    """Whether a number is finite, and none that only a whole number can be."""
    try:
        return math.isfinite(number)
    except OverflowError:
        return False


def slave_tolerance(experiment: Experiment) -> float | None:
    """Relative tolerance that the FMUs are given; None where they keep their own."""
    if experiment.slave_tolerance is not None or experiment.tolerance is None:
        return experiment.slave_tolerance
    return SLAVE_SHARE * experiment.tolerance


def step_count(start: float, stop: float, step: float) -> int:
    """Steps of length `step` from start to stop, the last one possibly shorter."""
    ratio = (stop - start) / step
    return round(ratio) if divides(start, stop, step) else math.ceil(ratio)


def divides(start: float, stop: float, step: float) -> bool:
    """Whether the horizon is a whole number of steps, up to rounding."""
    ratio = (stop - start) / step
    # Times far from zero resolve no more than their unit in the last place.
    rounding = max(GRID_ROUNDING * ratio, UNITS * math.ulp(max(abs(start), abs(stop))) / step)
    return round(ratio) >= 1 and abs(ratio - round(ratio)) <= min(rounding, GRID_SHARE)


def refuse_too_many_rows(name: str, interval: float, horizon: float) -> None:
    """Refuse an output interval that makes more rows than a run can have.

    Raises
    ------
    InvalidInput
    """
    if interval > 0.0 and horizon / interval > MOST_ROWS:
        raise InvalidInput(
            f"{name} = {interval:g} asks for {horizon / interval:.3g} "
            f"rows of a run; give {horizon / MOST_ROWS:g} or more"
        )


def require_resolved_periods(experiment: Experiment, outputs: Sequence[Output]) -> None:
    """Refuse what would make more points than a run can have, or than times can tell apart.

    Raises
    ------
    InvalidInput
    """
    start, stop = experiment.start_time, experiment.stop_time
    periods = [("step", experiment.step), *experiment.periods.items()]
    for output in outputs:
        if output.interval is not None:
            refuse_too_many_rows("output interval", output.interval, stop - start)
            periods.append(("output interval", output.interval))
    for name, period in periods:
        if period is None:
            continue
        if not (math.isfinite(period) and period > 0.0):
            raise InvalidInput(f"{name} {period:g} must be positive and finite, in seconds")
        smallest = max(
            RESOLVED * math.ulp(max(abs(start), abs(stop))), (stop - start) / MOST_POINTS
        )
        if period < smallest:
            raise InvalidInput(
                f"{name} {period:g} is too small from {start:g} to {stop:g}; it is at least "
                f"{smallest:.2g} there, in seconds"
            )


def require_abilities(system: ResolvedSystem, experiment: Experiment) -> None:
    """Refuse a coupling or FMUs that cannot do what the run asks of them.

    Raises
    ------
    InvalidInput
        Names the component, the purpose and what to use instead.
    """
    coupling, step, tolerance = (
        experiment.chosen_coupling,
        experiment.step,
        experiment.tolerance,
    )
    refuse_tolerance(coupling, tolerance)
    if isinstance(coupling, ModelExchange):
        if tolerance is None:
            raise InvalidInput(
                f"coupling '{coupling.name}' chooses its steps by a tolerance; give one"
            )
        for member in system.members:
            if member.description.equations is None:
                raise InvalidInput(
                    f"component '{member.name}': {member.description.path.name} offers no model "
                    f"exchange, which the coupling '{coupling.name}' needs; take a native FMU "
                    "(native = true in a scenario), or another coupling"
                )
        return
    purpose = None
    predicts = isinstance(coupling, Derivative | Hermite) and coupling.control == "prediction"
    if tolerance is not None and not predicts:
        purpose = "a tolerance (steps are taken back)"
    elif coupling.rolls_back:
        purpose = f"the coupling '{coupling.name}' (steps are repeated)"
    # Steps have one length unless they are chosen, or one is cut at the end or by the coupling.
    varies = tolerance is not None or (
        step is not None
        and not (
            divides(experiment.start_time, experiment.stop_time, step)
            and all(
                divides(0.0, max(step, period), min(step, period))
                for period in coupling.periods.values()
            )
        )
    )
    for member in system.members:
        fmu = f"component '{member.name}': {member.description.path.name}"
        if purpose is not None and not member.description.can_get_and_set_state:
            raise InvalidInput(
                f"{fmu} cannot get and set its state, which {purpose} needs; use the coupling "
                "'auto', or 'derivative' with a fixed step"
            )
        if varies and not member.description.can_vary_step:
            raise InvalidInput(
                f"{fmu} takes steps of one length only; give no tolerance, and a step that divides "
                "the horizon and whatever the coupling samples"
            )
