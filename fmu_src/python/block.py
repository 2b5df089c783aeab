"""The base of every FMU here: evaluation, state machine, stepping, complete state."""

from __future__ import annotations

import sys

from pythonfmu.enums import Fmi2Status

from . import interface, snapshot
from .exit_guard import guard
from .integrator import integrate
from .parameters import ParameterError, bind, reason
from .variables import VariableTable

__all__ = ["Block"]

# Relative tolerance of the internal integration where fmi2SetupExperiment gives none.
DEFAULT_TOLERANCE = 1e-8
# A communication point may differ from the instance's own time by rounding of this relative size.
TIME_ROUNDING = 1e-9
# First internal step tried, in seconds; the step control takes it from there.
FIRST_STEP = 1e-3

_OUTPUTS = frozenset(interface.OUTPUTS)
_DERIVATIVES = frozenset(interface.DERIVATIVES)
INSTANTIATED, INITIALIZATION, STEPPING, TERMINATED = range(4)
_WHEN = (
    "before fmi2EnterInitializationMode",
    "in initialization mode",
    "after initialization",
    "after fmi2Terminate",
)


class Block(VariableTable):
    """A plant, a controller, or a block beside them.

    It has states x, inputs held or given as cubics, and outputs on demand.

    The modules `interface` (the table of variables) and `equations` are generated beside this one
    when the FMU is built.
    """

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        guard(self.resources)
        # The wrapper puts the resources on sys.path once for every instance; once is enough.
        if sys.path.count(self.resources) > 1:
            sys.path.remove(self.resources)
        self._mode = INSTANTIATED
        self._time = 0.0
        self._stop_time = None
        self._tolerance = DEFAULT_TOLERANCE
        self._h = FIRST_STEP
        self._bound = None
        self._x = ()
        self._settle()

    # -- evaluation --------------------------------------------------------------------------

    def _settle(self):
        """Where parameters were set: check them, compute the gains, close the equations over both.

        Done when something depends on it, not at each fmi2SetXXX: of two parameters that must
        fit together, one is set first. A fault keeps the equations as they were before it.
        """
        if self._settled:
            return
        self._settled = True
        try:
            self._bound = self._bind()
        except ParameterError as error:
            self._fault("parameters", str(error))
            return
        self._faults.pop("parameters", None)
        self._x = tuple(self._constants[vr] for vr in interface.STARTS)

    def _bind(self):
        return bind(self._constants)

    def _evaluate(self, reference):
        self._settle()
        bound, computed = self._bound, self._computed
        if bound is None:
            # A default that depends on where the FMU runs: a table whose file is not there.
            self._report(
                f"nothing can be evaluated: {self._faults['parameters']}", Fmi2Status.error
            )
            return
        try:
            if reference in _OUTPUTS:
                group = interface.OUTPUTS
                numbers = bound.outputs(self._x, self._values_now(), *self._theta_now())
            elif reference in _DERIVATIVES:
                group = interface.DERIVATIVES
                slopes = self._slopes_now()
                theta = self._theta_and_slopes_now()
                numbers = bound.derivatives(self._x, self._values_now(), slopes, *theta)
            else:
                computed.update(zip(interface.GAINS, bound.gains))
                computed.update(self._further_outputs())
                return
            computed.update(zip(group, numbers))
        except (ArithmeticError, ValueError) as error:
            self._report(
                f"the outputs cannot be evaluated at t = {self._time:.9g}: {reason(error)}; "
                f"{self._remedy()}",
                Fmi2Status.error,
            )
            return
        total = sum(numbers)
        if total * 0.0 != 0.0:
            self._report_overflow(group, numbers)

    def _report_overflow(self, group, numbers):
        lost = [interface.VARIABLES[vr].name for vr, n in zip(group, numbers) if n * 0.0 != 0.0]
        if lost:
            self._report(
                f"{', '.join(lost)} left the range of floating-point numbers at "
                f"t = {self._time:.9g}; {self._remedy()}",
                Fmi2Status.error,
            )

    def _remedy(self):
        """What to do about values that leave the range of floating-point numbers."""
        if self._mode < STEPPING:
            return "take less extreme parameters, start values or inputs"
        return (
            "the loop diverges: take a smaller communication step, or less extreme parameters "
            "and inputs"
        )

    def _further_outputs(self):
        """Outputs besides those of the equations, as {value reference: value}."""
        return {}

    def _theta_now(self):
        """theta(t) as the equations take it, where there is one."""
        return ()

    def _theta_and_slopes_now(self):
        """The same for the derivatives of outputs; slopes count where they are of signals."""
        return self._theta_now()

    def _values_now(self):
        """Values of the inputs, s seconds after the communication point."""
        s = self._s
        if s == 0.0:
            return self._inputs[: interface.PROPER_INPUTS]
        return [a + s * (b + s * (c + s * d)) for a, b, c, d in self._cubics()]

    def _slopes_now(self):
        """Their slopes then."""
        s = self._s
        return [b + s * (2.0 * c + s * 3.0 * d) for _, b, c, d in self._cubics()]

    def _cubics(self):
        """Coefficients of each input over the step: v, der(v), der(v,2)/2, der(v,3)/6."""
        if self._coefficients is None:
            n, v = interface.PROPER_INPUTS, self._inputs
            self._coefficients = [
                (v[i], v[n + i], v[2 * n + i] / 2.0, v[3 * n + i] / 6.0) for i in range(n)
            ]
        return self._coefficients

    # -- state machine -----------------------------------------------------------------------

    def _illegal(self, function):
        self._fault(function, f"{function} was called {_WHEN[self._mode]}")

    def _why_fixed(self):
        if self._mode in (INSTANTIATED, INITIALIZATION):
            return None
        return f"{_WHEN[self._mode]}; reset the instance first"

    def setup_experiment(self, start_time, stop_time=None, tolerance=None):
        if self._mode != INSTANTIATED:
            self._illegal("fmi2SetupExperiment")
            return
        given = start_time if stop_time is None else stop_time
        if not self._check_finite(startTime=start_time, stopTime=given):
            return
        if given < start_time:
            self._fault("stopTime", f"stopTime = {stop_time!r} is before startTime")
            return
        if tolerance is not None and not 0.0 < tolerance < 1.0:
            self._fault("tolerance", f"tolerance = {tolerance!r} is refused: 0 < tolerance < 1")
            return
        self._time = start_time
        self._stop_time = stop_time
        self._tolerance = DEFAULT_TOLERANCE if tolerance is None else tolerance
        self._computed.clear()

    def enter_initialization_mode(self):
        if self._mode != INSTANTIATED:
            self._illegal("fmi2EnterInitializationMode")
            return
        self._mode = INITIALIZATION

    def exit_initialization_mode(self):
        if self._mode != INITIALIZATION:
            self._illegal("fmi2ExitInitializationMode")
            return
        self._settle()
        self._mode = STEPPING

    def terminate(self):
        if self._mode != STEPPING:
            self._illegal("fmi2Terminate")
            return
        self._mode = TERMINATED

    # -- stepping ----------------------------------------------------------------------------

    def do_step(self, current_time, step_size):
        refusal = self._refusal(current_time, step_size)
        if refusal is None:
            try:
                self._x, self._h = self._advance(current_time, step_size)
            except (ArithmeticError, ValueError) as error:
                refusal = reason(error)
                # Errors of our own say what to do about them.
                if type(error) in (OverflowError, ZeroDivisionError, ValueError):
                    refusal += f"; {self._remedy()}"
        if refusal is not None:
            step = f"the step from t = {current_time:.9g} by {step_size:.9g} is discarded"
            self._report(f"{step}: {refusal}", Fmi2Status.discard)
            return False
        self._time = current_time + step_size
        self._s = step_size
        self._computed.clear()
        return True

    def _refusal(self, t, h):
        """Why a step cannot be taken, or None."""
        if self._mode != STEPPING:
            return f"fmi2DoStep was called {_WHEN[self._mode]}"
        if self._faults:
            return "; ".join(self._faults.values())
        if not 0.0 < h < float("inf"):
            return "the step size must be positive and finite"
        rounding = TIME_ROUNDING * max(1.0, abs(self._time))
        if not abs(t - self._time) <= rounding:
            return f"this instance is at t = {self._time!r}"
        if self._stop_time is not None and t + h > self._stop_time + rounding:
            return f"it ends after the stop time {self._stop_time!r}"
        return None

    def _advance(self, t, h):
        """The states a step later, and the internal step to try next."""
        if not self._x:
            return self._x, self._h
        return self._integrate(t, 0.0, h, self._x, self._h, None)

    def _integrate(self, t, start, end, x, h, theta):
        bound, v = self._bound, self._cubics()
        values = [a + start * (b + start * (c + start * d)) for a, b, c, d in v]
        k = bound.rates(x, values) if theta is None else bound.rates(x, values, theta(t + start))
        return integrate(bound.step, k, t, start, end, x, v, theta, h, self._tolerance)

    # -- complete state ----------------------------------------------------------------------

    def _get_fmu_state(self):
        self._settle()
        return (
            (self._mode, self._time, self._stop_time, self._tolerance, self._h, self._s),
            self._x,
            tuple(self._inputs),
            self._constants_taken,
            tuple(self._faults.items()),
        )

    def _set_fmu_state(self, state):
        if isinstance(state, snapshot.NotAState):
            self._fault("state", f"the state is refused: it is {state.reason}")
            return
        scalars, x, inputs, constants, faults = state
        if constants is not self._constants_taken and constants != self._constants_taken:
            self._constants, self._constants_taken = dict(constants), constants
            self._settled = False
            self._settle()
        (self._mode, self._time, self._stop_time, self._tolerance, self._h, self._s) = scalars
        self._x = x
        self._inputs[:] = inputs
        self._coefficients = None
        self._faults = dict(faults)
        self._computed.clear()

    @staticmethod
    def _fmu_state_to_bytes(state):
        return snapshot.to_bytes(interface.KEY, state)

    @staticmethod
    def _fmu_state_from_bytes(data):
        return snapshot.from_bytes(interface.KEY, data)
