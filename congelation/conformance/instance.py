"""One instance of an FMU, with the handful of calls that the rules make again and again."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterable, Sequence
from ctypes import byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p

from congelation.conformance.binding import (
    Callbacks,
    EventInfo,
    Library,
    Logger,
    LogMessage,
    Status,
    filled,
    pack,
    unpack,
)
from congelation.conformance.description import Value
from congelation.conformance.rule import Violated

__all__ = ["CO_SIMULATION", "ENVIRONMENT", "MODEL_EXCHANGE", "Instance"]

# fmi2Type
MODEL_EXCHANGE, CO_SIMULATION = 0, 1

# Values that only a mistake produces.
_HUGE = 1e300
_STATUSES = frozenset(status.value for status in Status)

# Handed to the FMU as componentEnvironment and expected back in every log message.
ENVIRONMENT = 0x5EED


class Instance:
    """A component, from fmi2Instantiate on.

    Parameters
    ----------
    library : Library
        Where it comes from.
    name, guid, uri : str
        Instance name, GUID, and the URI of the resources directory.
    logging : bool
        loggingOn.
    memory : bool
        Whether the memory functions are handed over, or null pointers in their place.
    kind : int
        `CO_SIMULATION` or `MODEL_EXCHANGE`.

    Attributes
    ----------
    component : int or None
        None if instantiation failed.
    messages : list of LogMessage
        What the FMU logged so far.
    """

    def __init__(
        self,
        library: Library,
        *,
        name: str,
        guid: str,
        uri: str,
        logging: bool = True,
        memory: bool = True,
        kind: int = CO_SIMULATION,
    ) -> None:
        self.library = library
        self.name = name
        self.messages: list[LogMessage] = []
        self._fatal = False
        self._callbacks = Callbacks(
            logger=Logger(self._log), componentEnvironment=c_void_p(ENVIRONMENT)
        )
        if memory:
            c_library = ctypes.CDLL(None)
            self._callbacks.allocateMemory = ctypes.cast(c_library.calloc, c_void_p)
            self._callbacks.freeMemory = ctypes.cast(c_library.free, c_void_p)
        self.component: int | None = library.call(
            "Instantiate",
            *(name.encode(), kind, guid.encode(), uri.encode()),
            *(byref(self._callbacks), 0, int(logging)),
        )

    def _log(
        self,
        environment: int | None,
        instance: bytes | None,
        status: int,
        category: bytes | None,
        text: bytes | None,
        *arguments: object,
    ) -> None:
        def shown(raw: bytes | None) -> str | None:
            return None if raw is None else raw.decode(errors="replace")

        self.messages.append(
            LogMessage(
                environment,
                shown(instance),
                status,
                shown(category),
                shown(text),
                filled(shown(text) or "", arguments),
            )
        )

    def call(self, name: str, *arguments: object) -> Status:
        """Call fmi2<name> on the component."""
        value = self.library.call(name, self.component, *arguments)
        if value not in _STATUSES:
            raise Violated(f"fmi2{name} returned {value}, which is no fmi2Status")
        self._fatal |= value == Status.FATAL
        return Status(value)

    def setup(
        self, start: float, stop: float | None = None, tolerance: float | None = None
    ) -> Status:
        """fmi2SetupExperiment; None for what is not defined."""
        return self.call(
            "SetupExperiment",
            *(int(tolerance is not None), tolerance or 0.0, start),
            *(int(stop is not None), stop or 0.0),
        )

    def enter(self) -> Status:
        """fmi2EnterInitializationMode."""
        return self.call("EnterInitializationMode")

    def leave(self) -> Status:
        """fmi2ExitInitializationMode."""
        return self.call("ExitInitializationMode")

    def step(self, time: float, size: float, *, final: bool = False) -> Status:
        """fmi2DoStep; `final` is noSetFMUStatePriorToCurrentPoint."""
        if not 0.0 < size < math.inf:
            self.library.probe = f"h = {size:g}"
        return self.call("DoStep", time, size, int(final))

    def enter_event_mode(self) -> Status:
        """fmi2EnterEventMode."""
        return self.call("EnterEventMode")

    def new_discrete_states(self) -> tuple[Status, EventInfo]:
        """fmi2NewDiscreteStates."""
        info = EventInfo()
        return self.call("NewDiscreteStates", byref(info)), info

    def enter_continuous_time_mode(self) -> Status:
        """fmi2EnterContinuousTimeMode."""
        return self.call("EnterContinuousTimeMode")

    def completed_step(self) -> tuple[Status, bool, bool]:
        """fmi2CompletedIntegratorStep; whether it asks for event mode, and for the end."""
        event, end = c_int(), c_int()
        status = self.call("CompletedIntegratorStep", 1, byref(event), byref(end))
        return status, bool(event), bool(end)

    def set_time(self, time: float) -> Status:
        """fmi2SetTime."""
        return self.call("SetTime", time)

    def set_states(self, x: Sequence[float]) -> Status:
        """fmi2SetContinuousStates."""
        return self.call("SetContinuousStates", pack("Real", x), len(x))

    def vector(self, name: str, count: int) -> tuple[Status, list[float]]:
        """fmi2GetContinuousStates, fmi2GetDerivatives and others by `name`: so many numbers."""
        values = (c_double * count)()
        return self.call(name, values, count), list(values)

    def terminate(self) -> Status:
        """fmi2Terminate."""
        return self.call("Terminate")

    def reset(self) -> Status:
        """fmi2Reset."""
        return self.call("Reset")

    def free(self) -> None:
        """fmi2FreeInstance; nothing a second time, and after fmi2Fatal, when no call is allowed."""
        if self.component is not None and not self._fatal:
            self.library.call("FreeInstance", self.component)
            self.component = None

    def get(self, base: str, references: Sequence[int]) -> tuple[Status, list[Value]]:
        """fmi2Get<base>."""
        blank: Value = "" if base == "String" else 0
        array = pack(base, [blank] * len(references))
        status = self.call(f"Get{base}", _vector(references), len(references), array)
        return status, unpack(base, array)

    def set(self, base: str, references: Sequence[int], values: Sequence[Value]) -> Status:
        """fmi2Set<base>."""
        if any(isinstance(v, float) and not abs(v) < _HUGE for v in values):
            self.library.probe = f"a value of {values[0]!r}"
        return self.call(f"Set{base}", _vector(references), len(references), pack(base, values))

    def set_input_derivatives(
        self, references: Sequence[int], orders: Sequence[int], values: Sequence[float]
    ) -> Status:
        """fmi2SetRealInputDerivatives."""
        return self.call(
            "SetRealInputDerivatives",
            *(_vector(references), len(references)),
            *((c_int * len(orders))(*orders), pack("Real", values)),
        )

    def get_output_derivatives(
        self, references: Sequence[int], orders: Sequence[int]
    ) -> tuple[Status, list[float]]:
        """fmi2GetRealOutputDerivatives."""
        values = (c_double * len(references))()
        status = self.call(
            "GetRealOutputDerivatives",
            *(_vector(references), len(references), (c_int * len(orders))(*orders), values),
        )
        return status, list(values)

    def directional_derivative(
        self, unknowns: Sequence[int], knowns: Sequence[int], seed: Sequence[float]
    ) -> tuple[Status, list[float]]:
        """fmi2GetDirectionalDerivative."""
        values = (c_double * len(unknowns))()
        status = self.call(
            "GetDirectionalDerivative",
            *(_vector(unknowns), len(unknowns), _vector(knowns), len(knowns)),
            *(pack("Real", seed), values),
        )
        return status, list(values)

    def get_state(self, handle: c_void_p | None = None) -> tuple[Status, c_void_p]:
        """fmi2GetFMUstate, into a new handle or over a former one."""
        state = c_void_p() if handle is None else handle
        return self.call("GetFMUstate", byref(state)), state

    def set_state(self, handle: c_void_p) -> Status:
        """fmi2SetFMUstate."""
        return self.call("SetFMUstate", handle)

    def free_state(self, handle: c_void_p) -> Status:
        """fmi2FreeFMUstate; the handle becomes null if the FMU keeps its promise."""
        return self.call("FreeFMUstate", byref(handle))

    def serialized_size(self, handle: c_void_p) -> tuple[Status, int]:
        """fmi2SerializedFMUstateSize."""
        size = c_size_t()
        return self.call("SerializedFMUstateSize", handle, byref(size)), size.value

    def serialize(self, handle: c_void_p, size: int, guard: int = 0) -> tuple[Status, bytes]:
        """fmi2SerializeFMUstate, with `guard` bytes of 0xA5 after the vector."""
        buffer = ctypes.create_string_buffer(b"\xa5" * (size + guard), size + guard)
        status = self.call("SerializeFMUstate", handle, buffer, size)
        return status, buffer.raw

    def deserialize(self, data: bytes) -> tuple[Status, c_void_p]:
        """fmi2DeSerializeFMUstate."""
        state = c_void_p()
        return self.call("DeSerializeFMUstate", data, len(data), byref(state)), state

    def set_logging(self, on: bool, categories: Iterable[str] = ()) -> Status:
        """fmi2SetDebugLogging."""
        names = [category.encode() for category in categories]
        array = (c_char_p * len(names))(*names)
        return self.call("SetDebugLogging", int(on), len(names), array)


def _vector(references: Sequence[int]) -> ctypes.Array[c_uint]:
    return (c_uint * len(references))(*references)
