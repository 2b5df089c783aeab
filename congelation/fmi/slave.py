"""One FMU instance: the calls of FMI 2.0, each with its status checked.

The calls of the stepping loop go to the C functions directly, with arrays made once: per call,
fmpy's convenience methods cost several times what the FMU itself needs.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from congelation.errors import SlaveError
from congelation.fmi.calls import CALLS
from congelation.fmi.description import Description, Variable
from congelation.fmi.library import DISCARD, FATAL, PENDING, STATUS_NAMES, WARNING, Log, load
from congelation.fmi.start_values import C_TYPES, Setting, StartValue, references_of

__all__ = ["TERMINATE", "Slave", "SlaveTerminated", "State", "StepDiscarded"]

TERMINATED_KIND = 3
"""fmi2Terminated, of fmi2StatusKind."""

TERMINATE = "fmi2Terminate"

Floats = npt.NDArray[np.float64]
State = ctypes.c_void_p
"""A handle to a saved FMU state, of one instance."""


class StepDiscarded(SlaveError):
    """The FMU could not make a step of this length; a shorter one may do."""


class SlaveTerminated(Exception):
    """The FMU ended the simulation run of its own accord: fmi2Discard with fmi2Terminated."""


class Slave:
    """One loaded FMU instance.

    Parameters
    ----------
    name : str
        Of the component; messages carry it.
    description : Description
        The FMU.
    exchange : bool
        Whether it is one of model exchange, rather than of co-simulation.

    Raises
    ------
    InvalidInput
        The FMU has no binary that loads here.
    SlaveError
        The FMU refused to be instantiated.
    """

    def __init__(self, name: str, description: Description, *, exchange: bool = False) -> None:
        self.name = name
        self.exchange = exchange
        self.description = description
        self.log = Log(name)
        self._states: list[State] = []
        self._broken = False
        self._is_complete = False
        # Each call is noted before it is made, so that one that never returns has a name.
        self._note = CALLS.note
        self._functions: dict[str, Any] = {}
        self._start: Setting | None = None
        self._codes: dict[str, int] = {}
        self._note[0] = self._code("fmi2Instantiate")
        self._fmu = load(description, name, self.log, exchange=exchange)
        self._component = ctypes.c_void_p(self._fmu.component)
        if not self._component:
            raise SlaveError(name, 0.0, self._reason("fmi2Instantiate returned NULL"))
        if not exchange:
            self._do_step = self._function(
                "fmi2DoStep", ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int
            )
        self._get_state = self._function("fmi2GetFMUstate")
        self._set_state = self._function("fmi2SetFMUstate")
        self._free_state = self._function("fmi2FreeFMUstate")
        self._step_code = self._code("fmi2DoStep")
        self._save_code = self._code("fmi2GetFMUstate")
        self._restore_code = self._code("fmi2SetFMUstate")
        self._free_code = self._code("fmi2FreeFMUstate")

    @property
    def time(self) -> float:
        """Communication point of the latest step, in seconds."""
        return self.log.time

    # -- life ---------------------------------------------------------------------------------

    def setup(
        self, start_time: float, stop_time: float | None = None, tolerance: float | None = None
    ) -> None:
        """fmi2SetupExperiment."""
        self.log.time = start_time
        self.call(
            "fmi2SetupExperiment",
            ctypes.c_int(tolerance is not None),
            ctypes.c_double(tolerance or 0.0),
            ctypes.c_double(start_time),
            ctypes.c_int(stop_time is not None),
            ctypes.c_double(stop_time or 0.0),
        )

    def enter_initialization(self) -> None:
        """fmi2EnterInitializationMode."""
        self.call("fmi2EnterInitializationMode")

    def exit_initialization(self) -> None:
        """fmi2ExitInitializationMode."""
        self.call("fmi2ExitInitializationMode")

    def complete(self) -> None:
        """The run has reached its end: fmi2Terminate is due, at the latest before the instance is
        reset or freed."""
        self._is_complete = True

    def terminate(self) -> str:
        """Call fmi2Terminate if it is due; returns what went wrong in one line, or nothing."""
        if not self._is_complete:
            return ""
        self._is_complete = False
        before = len(self.log.messages)
        self._note[0] = self._code(TERMINATE)
        status = self._function(TERMINATE)(self._component)
        self.log.error = None  # of a run that has ended
        self._broken = self._broken or status >= FATAL
        if status <= WARNING:
            return ""
        name = STATUS_NAMES[status] if status < len(STATUS_NAMES) else f"status {status}"
        reason = "".join(f": {m.line}" for m in list(self.log.messages)[before:][-1:])
        return f"{TERMINATE} of {self.name} ({self.description.path.name}) returned {name}{reason}"

    def reset(self) -> None:
        """fmi2Reset: as if instantiated anew; saved states are freed."""
        self.free_states()
        self.terminate()
        self.log.clear()
        if self._broken:
            raise SlaveError(self.name, self.time, "fmi2Terminate returned fmi2Fatal")
        self.call("fmi2Reset")

    def close(self) -> None:
        """Free the instance; after fmi2Fatal it is abandoned, as FMI 2.0 demands."""
        if self._component and not self._broken:
            self.free_states()
            self.terminate()
        if self._component and not self._broken:
            self._note[0] = self._code("fmi2FreeInstance")
            self._function("fmi2FreeInstance", ctypes.c_void_p, returns=None)(self._component)
        self._component = ctypes.c_void_p()

    @property
    def usable(self) -> bool:
        """Whether the instance may be called again (after a reset)."""
        return bool(self._component) and not self._broken

    def __enter__(self) -> Slave:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    # -- values -------------------------------------------------------------------------------

    def set_values(self, values: Iterable[StartValue]) -> None:
        """Set variables of any type, one call per type."""
        self._set(Setting(tuple(values)))

    def set_start(self, values: tuple[StartValue, ...]) -> None:
        """As `set_values`, for the values of a run, of which the next run changes a few."""
        if self._start is None or not self._start.takes(values):
            self._start = Setting(values)
        self._set(self._start)

    def _set(self, setting: Setting) -> None:
        for kind, references, scalars in setting.calls:
            self.call(f"fmi2Set{kind}", references, ctypes.c_size_t(len(scalars)), scalars)

    def set_value(self, variable: Variable, value: float | int | bool | str) -> None:
        """Set one variable of any type."""
        self.set_values([StartValue(variable, value)])

    def get_values(self, kind: str, references: Sequence[int]) -> list[float | int | bool | str]:
        """Read variables of one type: Real, Integer, Boolean or String."""
        values = (C_TYPES[kind] * len(references))()
        self.call(
            f"fmi2Get{kind}", references_of(references), ctypes.c_size_t(len(references)), values
        )
        if kind == "String":
            return [(value or b"").decode() for value in values]
        return [bool(value) for value in values] if kind == "Boolean" else list(values)

    def bound(
        self, function: str, references: Sequence[int], orders: Sequence[int], values: Floats
    ) -> Callable[[], None]:
        """A function without arguments that reads or sets Real variables, or derivatives of them.

        Parameters
        ----------
        function : str
            fmi2GetReal, fmi2SetReal, fmi2GetRealOutputDerivatives or fmi2SetRealInputDerivatives.
        references : sequence of int, length n
        orders : sequence of int, length n
            Of the derivatives; empty for the first two functions.
        values : array, shape (n,)
            Contiguous; it is kept, and read or overwritten at each call.
        """
        between = [(ctypes.c_int * len(orders))(*orders)] if orders else []
        return self._bound(function, references, values, *between)

    # -- stepping -----------------------------------------------------------------------------

    def step(self, time: float, length: float, no_return: int = 1) -> None:
        """fmi2DoStep from `time`; `no_return` is noSetFMUStatePriorToCurrentPoint.

        It is true also where a saved state may be restored: it lets an FMU flush what it has
        buffered; given false, some FMUs begin their next step where this one began.

        Raises
        ------
        StepDiscarded
            The FMU returned fmi2Discard.
        SlaveTerminated
            It returned fmi2Discard and ended the run.
        SlaveError
            It returned fmi2Error or worse.
        """
        self.log.time = time
        refusals = self.log.refusals
        self._note[0] = self._step_code
        status = self._do_step(self._component, time, length, no_return)
        if status > WARNING:
            self.refused("fmi2DoStep", status, refusals)

    def refused(self, function: str, status: int, refusals: int) -> NoReturn:
        """Raise what a status above fmi2Warning means.

        Parameters
        ----------
        function : str
            Which returned it.
        status : int
        refusals : int
            Messages of refusal that the log held before the call.
        """
        if function == "fmi2DoStep" and status == DISCARD and self.log.refusals == refusals:
            self._end_if_terminated()
        self._fail(function, status)

    def _end_if_terminated(self) -> None:
        """After fmi2Discard: ask whether the FMU wants no further step (FMI 2.0, 4.2.3).

        Only where it logged no refusal: pythonfmu answers yes after every discarded step.
        """
        error = self.log.error
        terminated = ctypes.c_int(0)
        self._note[0] = self._code("fmi2GetBooleanStatus")
        status = self._function("fmi2GetBooleanStatus")(
            self._component, TERMINATED_KIND, ctypes.byref(terminated)
        )
        self.log.error = error  # that of the step, not of an FMU that cannot answer
        if status <= WARNING and terminated.value:
            reason = self._reason("it gave no reason")
            raise SlaveTerminated(f"{self.name} at t = {self.time:.9g} ended the run: {reason}")

    # -- states saved and restored ------------------------------------------------------------

    def state_handle(self) -> State:
        """A handle that no state has been saved to; it is freed with the others."""
        state = State()
        self._states.append(state)
        return state

    def save(self) -> State:
        """fmi2GetFMUstate."""
        state = self.state_handle()
        self._note[0] = self._save_code
        self._check("fmi2GetFMUstate", self._get_state(self._component, ctypes.byref(state)))
        return state

    def save_into(self, state: State) -> None:
        """Save over a state of this instance that is no longer needed."""
        # Freed first: some FMUs would overwrite the pointer and lose the memory behind it.
        if state.value is not None:
            self._note[0] = self._free_code
            self._free_state(self._component, ctypes.byref(state))
            state.value = None
        self._note[0] = self._save_code
        self._check("fmi2GetFMUstate", self._get_state(self._component, ctypes.byref(state)))

    def restore(self, state: State) -> None:
        """fmi2SetFMUstate."""
        self._note[0] = self._restore_code
        self._check("fmi2SetFMUstate", self._set_state(self._component, state))

    def free_states(self) -> None:
        """Free every saved state."""
        self._note[0] = self._free_code
        for state in self._states:
            if state:
                self._free_state(self._component, ctypes.byref(state))
        self._states.clear()

    def serialize(self, state: State) -> bytes:
        """A saved state as bytes (fmi2SerializeFMUstate)."""
        size = ctypes.c_size_t()
        self.call("fmi2SerializedFMUstateSize", state, ctypes.byref(size))
        data = (ctypes.c_char * size.value)()
        self.call("fmi2SerializeFMUstate", state, data, size)
        return data.raw

    def deserialize(self, data: bytes) -> State:
        """The state that bytes stand for (fmi2DeSerializeFMUstate)."""
        state = State()
        buffer = ctypes.create_string_buffer(data, len(data))
        self.call(
            "fmi2DeSerializeFMUstate", buffer, ctypes.c_size_t(len(data)), ctypes.byref(state)
        )
        self._states.append(state)
        return state

    # -- failures -----------------------------------------------------------------------------

    def require_no_error(self) -> None:
        """Fail on a message of status fmi2Error even where no call returned it.

        pythonfmu cannot return fmi2Error from most calls: its FMUs log, and discard the next
        step. During initialisation the message is the failure.
        """
        if self.log.error is not None:
            raise SlaveError(self.name, self.time, self.log.error.line)

    def _reason(self, otherwise: str) -> str:
        message = self.log.error or (self.log.messages[-1] if self.log.messages else None)
        return otherwise if message is None else message.line or otherwise

    def _check(self, function: str, status: int) -> None:
        if status > WARNING:
            self._fail(function, status)

    def _fail(self, function: str, status: int) -> NoReturn:
        self._broken = self._broken or status >= FATAL
        name = STATUS_NAMES[status] if status < len(STATUS_NAMES) else f"status {status}"
        help_ = _HELP.get(status, "") if function == "fmi2DoStep" else ""
        reason = self._reason(f"{function} returned {name}{help_}")
        if "KeyboardInterrupt" in reason:
            # Ctrl-C reached Python code inside the FMU, and comes back as its last message.
            raise KeyboardInterrupt
        discarded = status == DISCARD and function in _DISCARDING
        raise (StepDiscarded if discarded else SlaveError)(self.name, self.time, reason, function)

    # -- C ------------------------------------------------------------------------------------

    @property
    def component(self) -> int:
        """The address of the instance, for compiled code."""
        return self._component.value or 0

    def address(self, function: str) -> int:
        """The address of a C function of the FMU, for compiled code."""
        return ctypes.cast(self._fmu.dll[function], ctypes.c_void_p).value or 0

    def note(self, function: str) -> tuple[int, int]:
        """Where a call of this instance is noted before it is made, and what stands for it."""
        return ctypes.addressof(ctypes.c_char.from_buffer(self._note)), self._code(function)

    def _function(
        self, name: str, *argument_types: type, returns: type | None = ctypes.c_int
    ) -> Callable[..., int]:
        """A C function of its own, without fmpy's argument types where none are given."""
        function = self._functions.get(name)
        if function is not None:
            return function  # type: ignore[no-any-return]  # fmpy publishes no types
        function = self._functions[name] = self._fmu.dll[name]
        function.restype = returns
        if argument_types:
            function.argtypes = argument_types
        return function  # type: ignore[no-any-return]  # fmpy publishes no types

    def _code(self, function: str) -> int:
        """What stands for a call of this instance in the note."""
        if function not in self._codes:
            text = f"{function} of {self.name} ({self.description.path.name})"
            self._codes[function] = CALLS.code(text)
        return self._codes[function]

    def call(self, name: str, *arguments: object) -> None:
        """Call a function of the FMU with C values behind the instance, and check its status.

        Raises
        ------
        StepDiscarded, SlaveError
        """
        self._note[0] = self._code(name)
        self._check(name, self._function(name)(self._component, *arguments))

    def _bound(
        self, name: str, references: Sequence[int], values: Floats, *between: object
    ) -> Callable[[], None]:
        function = self._function(name)
        arguments = (
            self._component,
            references_of(references),
            ctypes.c_size_t(len(references)),
            *between,
            values.ctypes.data_as(ctypes.c_void_p),  # keeps the array alive
        )
        note, code = self._note, self._code(name)

        def call() -> None:
            note[0] = code
            status = function(*arguments)
            if status > WARNING:
                self._fail(name, status)

        call.__doc__ = f"{name} of {len(references)} values of {self.name}, shape {values.shape}"
        return call


_DISCARDING = ("fmi2DoStep", "fmi2SetContinuousStates", "fmi2GetDerivatives")
"""Functions whose fmi2Discard asks for a shorter step."""

_HELP = {
    DISCARD: " (where the step is fixed: give a smaller one, or a tolerance)",
    PENDING: "; FMUs whose steps end later than the call are not run",
}
"""What helps where fmi2DoStep returned this without a reason."""
