"""`model_exchange` in the compiled loop: DOP853 from one event to the next."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from congelation.cosim.compiled.base import (
    LATE,
    REFUSED,
    TERMINATED,
    UNSETTLED,
    UNSOLVED,
    Compiled,
)
from congelation.cosim.compiled.structures import Integrator, Part
from congelation.cosim.coupling.model_exchange import (
    ModelExchangeStepper,
    Smooth,
    ended_by,
    late,
    unsettled,
)
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange
from congelation.cosim.recording import Rows

__all__ = ["CompiledIntegrator", "CompiledRates", "method_arrays"]

Floats = npt.NDArray[np.float64]

VISITS = 1024
"""Times between steps at which rows are asked for, that are handed over at once."""


def method_arrays(n: int) -> dict[str, Floats]:
    """The coefficients of DOP853 and its room for n states, by their fields of `Integrator`."""
    from scipy.integrate import DOP853  # which no other coupling waits for

    return {
        **{
            name: np.ascontiguousarray(getattr(DOP853, name.upper()))
            for name in ("A", "B", "C", "D", "E3", "E5", "A_extra", "C_extra")
        },
        **{name: np.zeros(n) for name in ("x", "x_old", "x_new")},
        "K": np.zeros(16 * n),
        "F": np.zeros(7 * n),
        "work": np.zeros(2 * n),
    }


class CompiledRates:
    """f(t, x) of a system, compiled.

    Parameters
    ----------
    stepper : ModelExchangeStepper
    """

    def __init__(self, stepper: ModelExchangeStepper) -> None:
        drive = stepper.drive
        self.stepper = stepper
        self.driven = Compiled(drive, (), stepper.carried, False, np.inf)
        n = len(stepper.nominal)
        self._positive = [np.zeros(e.indicators, np.uint8) for e in stepper.equations]
        most = max((e.indicators for e in stepper.equations), default=0)
        self._keep = (np.zeros(n), np.zeros(most))
        self._parts = (Part * len(drive.slaves))(*map(self._part, range(len(drive.slaves))))
        self.fields = Integrator(
            drive=ctypes.pointer(self.driven.loop),
            parts=self._parts,
            n=n,
            indicators=self._keep[1].ctypes.data,
        )
        self._at, self._found = np.zeros(n), np.zeros(n)
        self._function = self.driven.library.integrator_rates
        self._function.argtypes = [
            ctypes.c_void_p,
            ctypes.c_double,
            ctypes.c_void_p,
            ctypes.c_void_p,
        ]

    def _part(self, m: int) -> Part:
        slave, equations = self.stepper.drive.slaves[m], self.stepper.equations[m]

        def note(function: str) -> int:
            return slave.note(function)[1]

        completed = "fmi2CompletedIntegratorStep"
        return Part(
            set_time=slave.address("fmi2SetTime"),
            set_states=slave.address("fmi2SetContinuousStates"),
            get_rates=slave.address("fmi2GetDerivatives"),
            get_indicators=slave.address("fmi2GetEventIndicators"),
            completed=slave.address(completed) if equations.completes else None,
            enter_event=slave.address("fmi2EnterEventMode"),
            enter_continuous=slave.address("fmi2EnterContinuousTimeMode"),
            new_states=slave.address("fmi2NewDiscreteStates"),
            get_states=slave.address("fmi2GetContinuousStates"),
            get_nominals=slave.address("fmi2GetNominalsOfContinuousStates"),
            time_note=note("fmi2SetTime"),
            states_note=note("fmi2SetContinuousStates"),
            rates_note=note("fmi2GetDerivatives"),
            indicators_note=note("fmi2GetEventIndicators"),
            completed_note=note(completed),
            event_note=note("fmi2NewDiscreteStates"),
            n_states=equations.states,
            n_indicators=equations.indicators,
            first=self.stepper.parts[m].start,
            positive=self._positive[m].ctypes.data,
        )

    def __call__(self, time: float, x: Floats) -> Floats:
        """f(t, x), shape (n,), as `ModelExchangeStepper.rates`."""
        loop = self.driven.loop
        loop.passes = loop.calls = 0
        self._at[:] = x
        self.driven.watch_refusals()
        code = self._function(
            ctypes.addressof(self.fields), time, self._at.ctypes.data, self._found.ctypes.data
        )
        self.count()
        self.driven.raise_for(code, time)
        return self._found.copy()

    def count(self) -> None:
        """Add the evaluations, and the calls that they took besides their regular pattern."""
        loop, stepper = self.driven.loop, self.stepper
        stepper.iterations += loop.passes
        stepper.drive.calls += loop.calls

    def follow(self, state: Smooth) -> None:
        """Take over the signs of the indicators after an event."""
        for mine, positive in zip(self._positive, state.positive, strict=True):
            mine[:] = positive


class CompiledIntegrator(Compiled):
    """DOP853 between two events, compiled.

    Parameters
    ----------
    ensemble, rows, exchange, stop
        As of `Compiled`.
    stepper : ModelExchangeStepper
    tolerance : float
        Of the integrator.
    """

    def __init__(
        self,
        ensemble: Ensemble,
        rows: Sequence[Rows],
        exchange: Exchange,
        stop: float,
        stepper: ModelExchangeStepper,
        tolerance: float,
    ) -> None:
        super().__init__(ensemble, rows, exchange, False, stop)
        self.rates = CompiledRates(stepper)
        n = len(stepper.nominal)
        fields = self.rates.fields
        fields.tolerance = tolerance
        fields.Y_before, fields.n_Y = self._address(np.zeros(len(ensemble.Y))), len(ensemble.Y)
        fields.leaves = stepper.leaves
        fields.nominal = self._address(stepper.nominal)
        arrays = method_arrays(n)
        for name, array in arrays.items():
            setattr(fields, name, self._address(array))
        self._x = arrays["x"]
        self._visits = np.zeros(0)
        self._within = self.library.integrator_states
        self._within.argtypes = [
            ctypes.c_void_p,
            ctypes.c_double,
            ctypes.c_double,
            ctypes.c_void_p,
        ]

    def restart(self, state: Smooth, first_step: float | None) -> None:
        """Get ready to go on from an event."""
        fields = self.rates.fields
        self.rates.follow(state)
        self._x[:] = state.x
        fields.step, fields.event = first_step or 0.0, state.event
        fields.restarts, fields.reached, fields.displaced, fields.in_event = 1, 0, 0, 0
        fields.largest = 0.0

    def integrate(self, time: float, most: int) -> tuple[int, float]:
        """Go on towards the stop time, for at most `most` steps.

        Returns
        -------
        code : int
            DONE; FULL; or why it ended: of CROSSED, the last step ends at the time returned.
        time : float
        """
        fields = self.rates.fields
        due = [rows.due(self.loop.stop, VISITS) for rows in self._rows]
        until = min((times[-1] for times in due if len(times) == VISITS), default=np.inf)
        self._visits = np.array(sorted({t for times in due for t in times if t <= until}))
        fields.visits, fields.n_visits = self._visits.ctypes.data, len(self._visits)
        fields.visited, fields.more = 0, until < np.inf
        fields.near = min((rows.near for rows in self._rows), default=np.inf)
        now = ctypes.c_double(time)
        self.rates.driven.loop.function = None
        self.rates.driven.watch_refusals()
        code = self.called(
            self.library.run_dop853,
            most,
            ctypes.byref(fields),
            ctypes.byref(now),
        )
        self.rates.count()
        return code, now.value

    @property
    def started(self) -> float:
        """Where the last step began, in seconds."""
        return float(self.rates.fields.t_old)

    @property
    def error(self) -> float:
        """Largest error of the steps since the last restart, relative to the tolerance."""
        return float(self.rates.fields.largest)

    @property
    def length(self) -> float:
        """Of the step that was tried last, or is next, in seconds."""
        return float(self.rates.fields.step)

    def ended(self, code: int, time: float) -> None:
        """Raise what ended a run: in an evaluation of f, at an event, or where rows were read.

        Raises
        ------
        SlaveError, SlaveTerminated, RunEnded
        """
        driven, fields = self.rates.driven, self.rates.fields
        slave = self.ensemble.slaves[fields.ended]
        if code == TERMINATED:
            raise ended_by(slave, time)
        if code == LATE:
            raise late(slave, time, float(fields.event))
        if code == UNSETTLED:
            raise unsettled(time)
        if (code == UNSOLVED and not fields.in_event) or (code == REFUSED and driven.loop.function):
            driven.raise_for(code, time)
        self.raise_for(code, time)

    def within(self, end: float, at: float) -> Floats:
        """The states at a time within the last step, which ended at `end`."""
        found = np.zeros(len(self._x))
        self.rates.driven.loop.passes = self.rates.driven.loop.calls = 0
        code = self._within(ctypes.addressof(self.rates.fields), end, at, found.ctypes.data)
        self.rates.count()
        self.rates.driven.raise_for(code, at)
        return found
