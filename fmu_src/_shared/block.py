"""The base of every FMU here: variables, state machine, faults, stepping, complete state.

pythonfmu's wrapper turns an exception that leaves a slave into fmi2Fatal and can crash the host
when the instance is freed; it has no way to return fmi2Error from Python. So nothing is raised
out of this module: a bad value is logged with status error and refused, the last good value
stays, and every fmi2DoStep is discarded until the fault is mended (a good value is set, a good
state is restored, or the instance is reset).
"""

from __future__ import annotations

import sys
from math import isfinite

from pythonfmu.enums import Fmi2Causality, Fmi2Initial, Fmi2Status, Fmi2Variability
from pythonfmu.fmi2slave import Fmi2Slave
from pythonfmu.variables import Boolean, Integer, Real, String

from . import equations, interface, snapshot
from .integrator import integrate
from .parameters import ParameterError, bind

__all__ = ["Block"]

# Relative tolerance of the internal integration where fmi2SetupExperiment gives none.
DEFAULT_TOLERANCE = 1e-8
# A communication point may differ from the instance's own time by rounding of this relative size.
TIME_ROUNDING = 1e-9
# First internal step tried, in seconds; the step control takes it from there.
FIRST_STEP = 1e-3

INSTANTIATED, INITIALIZATION, STEPPING, TERMINATED = range(4)
_MODE_NAMES = (
    "before fmi2EnterInitializationMode",
    "in initialization mode",
    "between steps",
    "after fmi2Terminate",
)
_TYPES = {"Real": Real, "Integer": Integer, "Boolean": Boolean, "String": String}
_READ = {"Real": float, "Integer": int, "Boolean": bool, "String": str}


class _Computed(dict):
    """Values that follow from the states and inputs, computed when first asked for."""

    def __init__(self, compute):
        super().__init__()
        self._compute = compute

    def __missing__(self, reference):
        return self._compute(reference)


class Block(Fmi2Slave):
    """A plant or controller: states x, inputs held or given as cubics, outputs on demand.

    The modules `interface` (the table of variables) and `equations` are generated beside this one
    when the FMU is built.
    """

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        # The wrapper puts the resources on sys.path once for every instance; once is enough.
        if sys.path.count(self.resources) > 1:
            sys.path.remove(self.resources)
        self.modelName = interface.NAME
        self.description = interface.DESCRIPTION
        self._register(interface.VARIABLES)
        self._constants = {
            vr: v.start
            for vr, v in enumerate(interface.VARIABLES)
            if v.causality == "parameter"
        }
        # The same as a tuple, replaced when one changes: states taken in between share it.
        self._constants_taken = tuple(self._constants.items())
        self._slots = {vr: slot for slot, vr in enumerate(interface.INPUTS)}
        self._inputs = [0.0] * len(interface.INPUTS)
        self._computed = _Computed(self._compute)
        self._mode = INSTANTIATED
        self._time = 0.0
        self._stop_time = None
        self._tolerance = DEFAULT_TOLERANCE
        self._h = FIRST_STEP
        # Time since the last communication point at which the inputs hold: 0 once they are set,
        # the length of the step right after it.
        self._s = 0.0
        self._faults = {}
        self._bound = None
        self._x = ()
        # False while parameters were set that the equations do not know yet.
        self._settled = False
        self._settle()

    # -- variables ---------------------------------------------------------------------------

    def _register(self, variables):
        for v in variables:
            start = {} if v.start is None else {"start": v.start}
            initial = {} if v.initial is None else {"initial": Fmi2Initial[v.initial]}
            self.register_variable(
                _TYPES[v.type](
                    v.name,
                    causality=Fmi2Causality[v.causality],
                    variability=Fmi2Variability[v.variability],
                    description=v.description,
                    getter=None,
                    **start,
                    **initial,
                ),
                nested=False,
            )

    def get_real(self, vrs):
        computed = self._computed
        return [computed[vr] for vr in vrs]

    def get_integer(self, vrs):
        return [self._constant(vr, "Integer", 0) for vr in vrs]

    def get_boolean(self, vrs):
        return [self._constant(vr, "Boolean", False) for vr in vrs]

    def get_string(self, vrs):
        return [self._constant(vr, "String", "") for vr in vrs]

    def _constant(self, vr, kind, otherwise):
        """A parameter of the given type; an unknown reference is a fault and reads `otherwise`."""
        variables = interface.VARIABLES
        if 0 <= vr < len(variables) and variables[vr].type == kind and vr in self._constants:
            return self._constants[vr]
        self._fault(vr, "value reference %d is no %s variable of this model" % (vr, kind))
        return otherwise

    def _compute(self, vr):
        """The value of a Real variable that is not in the table of computed values yet."""
        slot = self._slots.get(vr)
        if slot is not None:
            return self._inputs[slot]
        if vr in interface.COMPUTED:
            self._evaluate(vr)
            return self._computed.get(vr, 0.0)
        return float(self._constant(vr, "Real", 0.0))

    def _evaluate(self, vr):
        """Fill the table of computed values, with the group that `vr` belongs to."""
        self._settle()
        bound, computed = self._bound, self._computed
        values, slopes = self._inputs_now()
        try:
            if vr in interface.DERIVATIVES:
                group = interface.DERIVATIVES
                numbers = bound.derivatives(self._x, values, slopes, *self._theta_now())
            else:
                group = interface.OUTPUTS
                numbers = bound.outputs(self._x, values, *self._theta_now())
                computed.update(zip(interface.GAINS, bound.gains))
                computed.update(self._further_outputs())
            computed.update(zip(group, numbers))
        except (ArithmeticError, ValueError) as error:
            self._report("the outputs cannot be evaluated: %s" % error, Fmi2Status.error)
            return
        total = sum(numbers)
        if total - total != 0.0:
            self._report_overflow(group, numbers)

    def _report_overflow(self, group, numbers):
        variables = interface.VARIABLES
        lost = [vr for vr, n in zip(group, numbers) if n * 0.0 != 0.0]
        self._report(
            "%s left the range of floating-point numbers at t = %.9g; the loop diverges: "
            "take a smaller communication step"
            % (", ".join(variables[vr].name for vr in lost), self._time),
            Fmi2Status.error,
        )

    def _further_outputs(self):
        """Outputs besides those of the equations, as {value reference: value}."""
        return {}

    def _theta_now(self):
        """The arguments that theta(t) adds to the equations."""
        return ()

    def _inputs_now(self):
        """Values and slopes of the inputs, s seconds after the communication point."""
        n, v, s = interface.PROPER_INPUTS, self._inputs, self._s
        if s == 0.0:
            return v[:n], v[n : 2 * n]
        values, slopes = [], []
        for a, b, c, d in zip(v[:n], v[n : 2 * n], v[2 * n : 3 * n], v[3 * n : 4 * n]):
            values.append(a + s * (b + s * (c / 2.0 + s * d / 6.0)))
            slopes.append(b + s * (c + s * d / 2.0))
        return values, slopes

    def _cubics(self):
        n, v = interface.PROPER_INPUTS, self._inputs
        return [(v[i], v[n + i], v[2 * n + i] / 2.0, v[3 * n + i] / 6.0) for i in range(n)]

    def set_real(self, vrs, values):
        slots, inputs = self._slots, self._inputs
        for vr, value in zip(vrs, values):
            slot = slots.get(vr)
            if slot is None:
                self._set_constant(vr, value, "Real")
            elif value * 0.0 == 0.0:
                inputs[slot] = value
                if self._faults:
                    self._faults.pop(vr, None)
            else:
                self._refuse(vr, value, "finite")
        self._computed.clear()
        self._s = 0.0

    def set_integer(self, vrs, values):
        for vr, value in zip(vrs, values):
            self._set_constant(vr, value, "Integer")

    def set_boolean(self, vrs, values):
        for vr, value in zip(vrs, values):
            self._set_constant(vr, bool(value), "Boolean")

    def set_string(self, vrs, values):
        for vr, value in zip(vrs, values):
            self._set_constant(vr, value, "String")

    def _set_constant(self, vr, value, kind):
        """Set a parameter: before the first step only, finite, of the right type."""
        variables = interface.VARIABLES
        known = 0 <= vr < len(variables) and variables[vr].type == kind
        if not known or vr not in self._constants:
            self._fault(vr, "value reference %d is no %s that can be set" % (vr, kind))
        elif self._mode not in (INSTANTIATED, INITIALIZATION):
            name = variables[vr].name
            self._fault(
                vr,
                "%s is fixed and cannot be set %s; reset the instance first"
                % (name, _MODE_NAMES[self._mode]),
            )
        elif kind == "Real" and not isfinite(value):
            self._refuse(vr, value, "finite")
        else:
            self._constants[vr] = value
            self._constants_taken = tuple(self._constants.items())
            self._faults.pop(vr, None)
            self._computed.clear()
            self._settled = False

    def _refuse(self, vr, value, valid):
        name = interface.VARIABLES[vr].name
        self._fault(vr, "%s = %s is refused: it must be %s" % (name, value, valid))

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

    # -- faults ------------------------------------------------------------------------------

    def _fault(self, key, message):
        if self._faults.get(key) != message:
            self._faults[key] = message
            self._report(message, Fmi2Status.error)

    def _report(self, message, status):
        self.log("%s: %s" % (self.instance_name, message), status)

    def _discard(self, message):
        self._report(message, Fmi2Status.discard)
        return False

    def _illegal(self, function):
        self._fault(function, "%s was called %s" % (function, _MODE_NAMES[self._mode]))

    # -- state machine -----------------------------------------------------------------------

    def setup_experiment(self, start_time, stop_time=None, tolerance=None):
        if self._mode != INSTANTIATED:
            self._illegal("fmi2SetupExperiment")
            return
        for name, value in (("startTime", start_time), ("stopTime", stop_time)):
            if value is not None and not isfinite(value):
                self._fault(name, "%s = %s is refused: it must be finite" % (name, value))
                return
        if stop_time is not None and stop_time < start_time:
            self._fault("stopTime", "stopTime = %r is before startTime" % stop_time)
            return
        if tolerance is not None and not 0.0 < tolerance < 1.0:
            self._fault("tolerance", "tolerance = %r is refused: 0 < tolerance < 1" % tolerance)
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
        if refusal is not None:
            return self._discard(refusal)
        try:
            x, h = self._advance(current_time, step_size)
        except (ArithmeticError, ValueError) as error:
            return self._discard(
                "the step from t = %.9g by %.3g is discarded: %s" % (current_time, step_size, error)
            )
        self._x, self._h = x, h
        self._time = current_time + step_size
        self._s = step_size
        self._computed.clear()
        return True

    def _refusal(self, t, h):
        """Why a step cannot be taken, or None."""
        if self._mode != STEPPING:
            return "fmi2DoStep was called %s" % _MODE_NAMES[self._mode]
        if self._faults:
            return "; ".join(self._faults.values())
        if not (h > 0.0 and isfinite(h)):
            return "step size %r is refused: it must be positive and finite" % h
        rounding = TIME_ROUNDING * max(1.0, abs(self._time))
        if not abs(t - self._time) <= rounding:
            return "the step starts at t = %r, but this instance is at t = %r" % (t, self._time)
        if self._stop_time is not None and t + h > self._stop_time + rounding:
            return "the step from t = %r by %r ends after the stop time %r" % (
                t,
                h,
                self._stop_time,
            )
        return None

    def _advance(self, t, h):
        """The states a step later, and the internal step to try next."""
        return self._integrate(t, 0.0, h, self._x, self._h, None)

    def _integrate(self, t, start, end, x, h, theta):
        bound, v = self._bound, self._cubics()
        rates = bound.rates

        def rates_at(s, x):
            values = [a + s * (b + s * (c + s * d)) for a, b, c, d in v]
            return rates(x, values) if theta is None else rates(x, values, theta(t + s))

        return integrate(
            bound.step, rates_at, t, start, end, x, v, theta, h, self._tolerance
        )

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
            self._fault("state", "the state is refused: it is " + state.reason)
            return
        scalars, x, inputs, constants, faults = state
        if constants is not self._constants_taken and constants != self._constants_taken:
            self._constants, self._constants_taken = dict(constants), constants
            self._settled = False
            self._settle()
        (self._mode, self._time, self._stop_time, self._tolerance, self._h, self._s) = scalars
        self._x = x
        self._inputs[:] = inputs
        self._faults = dict(faults)
        self._computed.clear()

    @staticmethod
    def _fmu_state_to_bytes(state):
        return snapshot.to_bytes(interface.KEY, state)

    @staticmethod
    def _fmu_state_from_bytes(data):
        return snapshot.from_bytes(interface.KEY, data)
