"""The variables of an FMU, and the faults that bad values leave.

pythonfmu's wrapper turns an exception that leaves a slave into fmi2Fatal and can crash the host
when the instance is freed, and it has no way to return fmi2Error from Python. So nothing is
raised out of here: a bad value is logged with status error and refused, the last good value
stays, and every fmi2DoStep is discarded until the fault is mended: a good value is set, a good
state is restored, or the instance is reset.
"""

from __future__ import annotations

from abc import abstractmethod
from math import isfinite

from pythonfmu.enums import Fmi2Causality, Fmi2Initial, Fmi2Status, Fmi2Variability
from pythonfmu.fmi2slave import Fmi2Slave
from pythonfmu.variables import Boolean, Integer, Real, String

from . import interface

__all__ = ["VariableTable"]

_TYPES = {"Real": Real, "Integer": Integer, "Boolean": Boolean, "String": String}


class _Computed(dict):
    """Values that follow from the states and inputs, computed when first asked for."""

    def __init__(self, compute):
        super().__init__()
        self._compute = compute

    def __missing__(self, reference):
        return self._compute(reference)


class VariableTable(Fmi2Slave):
    """Inputs, parameters and computed values by value reference; the generated `interface`."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.modelName = interface.NAME
        self.description = interface.DESCRIPTION
        for variable in interface.VARIABLES:
            self._register(variable)
        self._constants = {
            vr: v.start for vr, v in enumerate(interface.VARIABLES) if v.causality == "parameter"
        }
        # The same as a tuple, replaced when one changes: states taken in between share it.
        self._constants_taken = tuple(self._constants.items())
        # False while parameters were set that the equations do not know yet.
        self._settled = False
        self._slots = {vr: slot for slot, vr in enumerate(interface.INPUTS)}
        self._inputs = [0.0] * len(interface.INPUTS)
        # Time since the last communication point at which the inputs hold: 0 once they are set,
        # the length of the step right after it.
        self._s = 0.0
        # The inputs over a step as cubics; None while inputs were set since.
        self._coefficients = None
        self._computed = _Computed(self._missing)
        self._faults = {}

    def _register(self, v):
        start = {} if v.start is None else {"start": v.start}
        initial = {} if v.initial is None else {"initial": Fmi2Initial[v.initial]}
        variable = _TYPES[v.type](
            v.name,
            causality=Fmi2Causality[v.causality],
            variability=Fmi2Variability[v.variability],
            description=v.description,
            **start,
            **initial,
        )
        self.register_variable(variable, nested=False)

    @abstractmethod
    def _evaluate(self, reference):
        """Fill the table of computed values with the group that `reference` belongs to."""

    @abstractmethod
    def _why_fixed(self):
        """Why parameters cannot be set now, or None where they can."""

    # -- reading -----------------------------------------------------------------------------

    def get_real(self, vrs):
        computed = self._computed
        return [computed[vr] for vr in vrs]

    def get_integer(self, vrs):
        return [self._constant(vr, "Integer", 0) for vr in vrs]

    def get_boolean(self, vrs):
        return [self._constant(vr, "Boolean", False) for vr in vrs]

    def get_string(self, vrs):
        return [self._constant(vr, "String", "") for vr in vrs]

    def _missing(self, vr):
        """The value of a Real variable that is not in the table of computed values."""
        slot = self._slots.get(vr)
        if slot is not None:
            return self._inputs[slot]
        if vr in interface.COMPUTED:
            self._evaluate(vr)
            return self._computed.get(vr, 0.0)
        return self._constant(vr, "Real", 0.0)

    def _constant(self, vr, kind, otherwise):
        """A parameter of the given type; an unknown reference is a fault and reads `otherwise`."""
        if self._is_parameter(vr, kind):
            return self._constants[vr]
        self._fault(vr, f"value reference {vr} is no {kind} variable of this model")
        return otherwise

    def _is_parameter(self, vr, kind):
        return vr in self._constants and interface.VARIABLES[vr].type == kind

    # -- writing -----------------------------------------------------------------------------

    def set_real(self, vrs, values):
        slots, inputs = self._slots, self._inputs
        for vr, value in zip(vrs, values):
            slot = slots.get(vr)
            # Only a finite value times zero is zero.
            if value * 0.0 != 0.0:
                self._refuse(vr, value)
            elif slot is None:
                self._set_constant(vr, value, "Real")
            else:
                inputs[slot] = value
                if self._faults:
                    self._faults.pop(vr, None)
        self._computed.clear()
        self._coefficients = None
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
        """Set a parameter; refused once the instance is initialised, like any other variable."""
        if not self._is_parameter(vr, kind):
            self._fault(vr, f"value reference {vr} is no {kind} that can be set")
            return
        reason = self._why_fixed()
        if reason is not None:
            self._fault(vr, f"{interface.VARIABLES[vr].name} is fixed and cannot be set {reason}")
            return
        self._constants[vr] = value
        self._constants_taken = tuple(self._constants.items())
        self._settled = False
        self._computed.clear()
        self._faults.pop(vr, None)

    def _refuse(self, vr, value):
        known = 0 <= vr < len(interface.VARIABLES)
        name = interface.VARIABLES[vr].name if known else f"value reference {vr}"
        self._fault(vr, f"{name} = {value} is refused: it must be finite")

    # -- faults ------------------------------------------------------------------------------

    def _fault(self, key, message):
        """Log a fault, once, and keep it until it is mended."""
        if self._faults.get(key) != message:
            self._faults[key] = message
            self._report(message, Fmi2Status.error)

    def _check_finite(self, **values):
        """Whether all values are finite; a fault for each that is not."""
        for name, value in values.items():
            if not isfinite(value):
                self._fault(name, f"{name} = {value} is refused: it must be finite")
        return all(isfinite(value) for value in values.values())

    def _report(self, message, status):
        self.log(f"{self.instance_name}: {message}", status)
