"""An FMU instance of model exchange: the calls that one of co-simulation does not have."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from fmpy.fmi2 import fmi2EventInfo

from congelation.fmi.slave import Slave

__all__ = ["DiscreteStates", "Model"]

Floats = npt.NDArray[np.float64]


class DiscreteStates(NamedTuple):
    """What fmi2NewDiscreteStates said.

    Parameters
    ----------
    again : bool
        Whether it has to be called once more.
    ends : bool
        Whether the FMU wants no further step.
    event : float
        Time of its next event in seconds; infinite where there is none.
    """

    again: bool
    ends: bool
    event: float


class Model:
    """The calls of model exchange (FMI 2.0, chapter 3) on an instance.

    Each raises SlaveError where the FMU returns more than a warning.

    Parameters
    ----------
    slave : Slave
        Made with ``exchange=True``.
    """

    def __init__(self, slave: Slave) -> None:
        self.slave = slave

    def enter_event_mode(self) -> None:
        """fmi2EnterEventMode."""
        self.slave.call("fmi2EnterEventMode")

    def new_discrete_states(self) -> DiscreteStates:
        """fmi2NewDiscreteStates."""
        info = fmi2EventInfo()
        self.slave.call("fmi2NewDiscreteStates", ctypes.byref(info))
        event = info.nextEventTime if info.nextEventTimeDefined else float("inf")
        return DiscreteStates(
            bool(info.newDiscreteStatesNeeded), bool(info.terminateSimulation), event
        )

    def enter_continuous_time_mode(self) -> None:
        """fmi2EnterContinuousTimeMode."""
        self.slave.call("fmi2EnterContinuousTimeMode")

    def set_time(self, time: float) -> None:
        """fmi2SetTime."""
        self.slave.log.time = time
        self.slave.call("fmi2SetTime", ctypes.c_double(time))

    def set_states(self, x: Floats) -> None:
        """fmi2SetContinuousStates, from a contiguous array.

        Raises
        ------
        StepDiscarded, SlaveError
        """
        self._vector("fmi2SetContinuousStates", x)

    def get_states(self, x: Floats) -> None:
        """fmi2GetContinuousStates, into a contiguous array."""
        self._vector("fmi2GetContinuousStates", x)

    def get_rates(self, f: Floats) -> None:
        """fmi2GetDerivatives, into a contiguous array.

        Raises
        ------
        StepDiscarded, SlaveError
        """
        self._vector("fmi2GetDerivatives", f)

    def get_nominals(self, nominals: Floats) -> None:
        """fmi2GetNominalsOfContinuousStates, into a contiguous array."""
        self._vector("fmi2GetNominalsOfContinuousStates", nominals)

    def get_indicators(self, z: Floats) -> None:
        """fmi2GetEventIndicators, into a contiguous array."""
        self._vector("fmi2GetEventIndicators", z)

    def completed_step(self) -> tuple[bool, bool]:
        """fmi2CompletedIntegratorStep: whether the FMU asks for event mode, and for the end."""
        enter, terminate = ctypes.c_int(0), ctypes.c_int(0)
        self.slave.call(
            "fmi2CompletedIntegratorStep",
            ctypes.c_int(1),
            ctypes.byref(enter),
            ctypes.byref(terminate),
        )
        return bool(enter.value), bool(terminate.value)

    def _vector(self, function: str, values: Floats) -> None:
        pointer = values.ctypes.data_as(ctypes.c_void_p)
        self.slave.call(function, pointer, ctypes.c_size_t(len(values)))
