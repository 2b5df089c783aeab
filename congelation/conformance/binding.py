"""The C functions of an FMI 2.0 FMU, called raw through ctypes.

Nothing is checked or smoothed over on the way: a rule has to be able to make every wrong call,
and sees the status and the log messages exactly as they come. Before each call the name of the
function is written to a tape (a mapped file), so that whoever finds the process dead knows
which call killed it.
"""

from __future__ import annotations

import _ctypes  # the only door to dlclose
import ctypes
import mmap
import os
import platform
import re
from collections.abc import Callable, Sequence
from ctypes import POINTER, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

from congelation.conformance.description import Value

__all__ = [
    "EXCHANGE_FUNCTIONS",
    "FUNCTIONS",
    "Callbacks",
    "EventInfo",
    "Library",
    "LogMessage",
    "Logger",
    "Status",
    "Tape",
    "filled",
    "pack",
    "unpack",
]


class Status(IntEnum):
    """fmi2Status (section 2.1.3)."""

    OK = 0
    WARNING = 1
    DISCARD = 2
    ERROR = 3
    FATAL = 4
    PENDING = 5

    def __str__(self) -> str:
        return f"fmi2{'OK' if self is Status.OK else self.name.capitalize()}"


_component = c_void_p
_references = POINTER(c_uint)
_state = c_void_p

# The logger is variadic, which ctypes has not. By the calling convention of x86-64 (System V) the
# arguments behind `message` are in the sixth integer register, in eight floating-point registers
# and then on the stack; a function with these parameters sees them all, those that were not passed
# holding anything. Elsewhere messages are shown with their format as it is.
_VARIADIC = platform.machine() in ("x86_64", "AMD64") and platform.system() != "Windows"
_REGISTERS, _STACK = 8, 8
_MORE = (c_void_p, *(c_double,) * _REGISTERS, *(c_void_p,) * _STACK) if _VARIADIC else ()
Logger = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p, *_MORE)
_CONVERSION = re.compile(
    r"%(?P<flags>[-+ #0]*)(?P<width>\*|\d*)(?P<precision>\.(?:\*|\d*))?"
    r"(?:hh|h|ll|l|j|z|t|L)?(?P<kind>[diouxXeEfFgGaAcsp%])"
)


def filled(message: str, arguments: Sequence[Any]) -> str:
    """A message of the logger with its arguments in place of the conversions of printf."""
    if not arguments:
        return message
    numbers = list(arguments[1 : 1 + _REGISTERS])
    words = [arguments[0], *arguments[1 + _REGISTERS :]]

    def word() -> int:
        return int(words.pop(0) or 0) if words else 0

    def conversion(found: re.Match[str]) -> str:
        kind, width, precision = found["kind"], found["width"], found["precision"] or ""
        if kind == "%":
            return "%"
        width = str(ctypes.c_int(word()).value) if width == "*" else width
        precision = f".{ctypes.c_int(word()).value}" if precision == ".*" else precision
        value: Any
        if kind in "eEfFgGaA":
            value = (
                numbers.pop(0)
                if numbers
                else ctypes.c_double.from_buffer_copy(word().to_bytes(8, "little")).value
            )
            kind = "g" if kind in "aA" else kind
        elif kind == "s":
            value = _string_at(word())
        elif kind == "c":
            value, kind = chr(word() & 0xFF), "s"
        elif kind == "p":
            value, kind = f"{word():#x}", "s"
        else:
            raw = word()
            long = re.search(r"[ljzt]", found[0]) is not None
            signed = kind in "di"
            size = (
                (ctypes.c_int64 if signed else ctypes.c_uint64)
                if long
                else (ctypes.c_int32 if signed else ctypes.c_uint32)
            )
            value, kind = size(raw).value, "d" if kind == "u" else kind
        return str(f"%{found['flags']}{width}{precision}{kind}" % value)

    return _CONVERSION.sub(conversion, message)


def _string_at(address: int) -> str:
    """The C string at an address, read so that a wrong address does no harm."""
    text = b""
    try:
        with open("/proc/self/mem", "rb", buffering=0) as memory:
            memory.seek(address)
            while b"\0" not in text and len(text) < 2000:
                more = memory.read(64 - address % 64)
                text, address = text + more, address + len(more)
    except (OSError, OverflowError, ValueError):
        return text.decode(errors="replace") or "<no string>"
    return text.partition(b"\0")[0].decode(errors="replace")


_C_TYPES: dict[str, Any] = {
    "Real": c_double,
    "Integer": c_int,
    "Boolean": c_int,
    "String": c_char_p,
}


class Callbacks(ctypes.Structure):
    """fmi2CallbackFunctions (section 2.1.5)."""

    _fields_ = (
        ("logger", Logger),
        ("allocateMemory", c_void_p),
        ("freeMemory", c_void_p),
        ("stepFinished", c_void_p),
        ("componentEnvironment", c_void_p),
    )


class EventInfo(ctypes.Structure):
    """fmi2EventInfo (section 3.2.2)."""

    _fields_ = (
        ("newDiscreteStatesNeeded", c_int),
        ("terminateSimulation", c_int),
        ("nominalsOfContinuousStatesChanged", c_int),
        ("valuesOfContinuousStatesChanged", c_int),
        ("nextEventTimeDefined", c_int),
        ("nextEventTime", c_double),
    )


def _functions() -> dict[str, tuple[Any, ...]]:
    """Result and argument types of every function that a co-simulation FMU exports."""
    table: dict[str, tuple[Any, ...]] = {
        "GetTypesPlatform": (c_char_p,),
        "GetVersion": (c_char_p,),
        "SetDebugLogging": (c_int, _component, c_int, c_size_t, POINTER(c_char_p)),
        "Instantiate": (
            *(c_void_p, c_char_p, c_int, c_char_p, c_char_p),
            *(POINTER(Callbacks), c_int, c_int),
        ),
        "FreeInstance": (None, _component),
        "SetupExperiment": (c_int, _component, c_int, c_double, c_double, c_int, c_double),
        "EnterInitializationMode": (c_int, _component),
        "ExitInitializationMode": (c_int, _component),
        "Terminate": (c_int, _component),
        "Reset": (c_int, _component),
        "GetFMUstate": (c_int, _component, POINTER(_state)),
        "SetFMUstate": (c_int, _component, _state),
        "FreeFMUstate": (c_int, _component, POINTER(_state)),
        "SerializedFMUstateSize": (c_int, _component, _state, POINTER(c_size_t)),
        "SerializeFMUstate": (c_int, _component, _state, c_char_p, c_size_t),
        "DeSerializeFMUstate": (c_int, _component, c_char_p, c_size_t, POINTER(_state)),
        "GetDirectionalDerivative": (
            *(c_int, _component, _references, c_size_t, _references, c_size_t),
            *(POINTER(c_double), POINTER(c_double)),
        ),
        "DoStep": (c_int, _component, c_double, c_double, c_int),
        "CancelStep": (c_int, _component),
    }
    for derivative in ("SetRealInputDerivatives", "GetRealOutputDerivatives"):
        table[derivative] = (
            *(c_int, _component, _references, c_size_t),
            *(POINTER(c_int), POINTER(c_double)),
        )
    for name, kind in _C_TYPES.items():
        for verb in ("Get", "Set"):
            table[verb + name] = (c_int, _component, _references, c_size_t, POINTER(kind))
        if name != "Real":
            table[f"Get{name}Status"] = (c_int, _component, c_int, POINTER(kind))
    table["GetStatus"] = (c_int, _component, c_int, POINTER(c_int))
    table["GetRealStatus"] = (c_int, _component, c_int, POINTER(c_double))
    return table


def _exchange_functions() -> dict[str, tuple[Any, ...]]:
    """The same of the functions that model exchange has alone (sections 3.2.1 and 3.2.2)."""
    flag, vector = POINTER(c_int), (c_int, _component, POINTER(c_double), c_size_t)
    return {
        "EnterEventMode": (c_int, _component),
        "NewDiscreteStates": (c_int, _component, POINTER(EventInfo)),
        "EnterContinuousTimeMode": (c_int, _component),
        "CompletedIntegratorStep": (c_int, _component, c_int, flag, flag),
        "SetTime": (c_int, _component, c_double),
        "SetContinuousStates": vector,
        "GetDerivatives": vector,
        "GetEventIndicators": vector,
        "GetContinuousStates": vector,
        "GetNominalsOfContinuousStates": vector,
    }


# Names without the prefix "fmi2", of the common and the co-simulation part (section 4.2.4), and of
# model exchange.
FUNCTIONS: tuple[str, ...] = tuple(_functions())
EXCHANGE_FUNCTIONS: tuple[str, ...] = tuple(_exchange_functions())
_TABLE = {**_functions(), **_exchange_functions()}


# Bytes at the end of a tape that count what was written.
_COUNTER = 8


class Tape:
    """The name of the function being called, in a file that outlives the process.

    Parameters
    ----------
    path : Path
        Created with `LENGTH` bytes.
    """

    LENGTH = 256

    def __init__(self, path: Path) -> None:
        self._count = 0
        path.write_bytes(bytes(self.LENGTH))
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), self.LENGTH)

    def write(self, text: str) -> None:
        """Note what is about to happen; "" for nothing in particular."""
        self._count += 1
        room = self.LENGTH - _COUNTER
        self._map[:room] = text.encode()[:room].ljust(room, b"\0")
        self._map[room:] = self._count.to_bytes(_COUNTER, "little")

    @staticmethod
    def read(path: Path) -> str:
        """What a process wrote last, "" for nothing."""
        return Tape.state(path).partition(b"\0")[0].decode(errors="replace")

    @staticmethod
    def state(path: Path) -> bytes:
        """The whole file, which differs after each call; empty if there is none yet."""
        return path.read_bytes() if path.exists() else b""


@dataclass(frozen=True)
class LogMessage:
    """One call of the logger; None stands for a null pointer.

    Attributes
    ----------
    text, shown : str
        The message as it came, and with its arguments filled in.
    """

    environment: int | None
    instance: str | None
    status: int
    category: str | None
    text: str | None
    shown: str = ""


class Library:
    """The shared library of an FMU.

    Parameters
    ----------
    path : Path
        Of the shared library.
    tape : Tape
        Where each call is noted.

    Attributes
    ----------
    probe : str
        What a rule does that no correct host would do; noted with each later call, so that a
        crash is distinguished from one in a correct sequence of calls.

    Raises
    ------
    OSError
        The library cannot be loaded.
    """

    def __init__(self, path: Path, tape: Tape) -> None:
        self.path = path
        self._tape = tape
        self.probe = ""
        tape.write(f"dlopen({path.name})")
        # ctypes resolves all symbols at once (RTLD_NOW); hosts usually do so at the first call, so
        # that an FMU may leave the functions of libm to a host that has them.
        process = ctypes.CDLL(None)
        process.dlopen.restype, process.dlopen.argtypes = c_void_p, (c_char_p, c_int)
        process.dlerror.restype = c_char_p
        handle = process.dlopen(os.fsencode(path), os.RTLD_LAZY | os.RTLD_LOCAL)
        if not handle:
            raise OSError((process.dlerror() or b"no reason given").decode(errors="replace"))
        self._dll = ctypes.CDLL(str(path), handle=handle)
        tape.write("")
        self._found: dict[str, Callable[..., Any]] = {}

    def has(self, name: str) -> bool:
        """Whether the function fmi2<name> is exported."""
        try:
            self._function(name)
        except AttributeError:
            return False
        return True

    def call(self, name: str, *arguments: Any) -> Any:
        """Call fmi2<name>; its name stands on the tape meanwhile."""
        function = self._function(name)
        self._tape.write(f"fmi2{name}" + (f" ({self.probe})" if self.probe else ""))
        result = function(*arguments)
        self._tape.write("")
        return result

    def unload(self) -> None:
        """Close the handle; the object cannot be used afterwards."""
        self._tape.write(f"dlclose({self.path.name})")
        _ctypes.dlclose(self._dll._handle)
        self._tape.write("")
        self._found.clear()

    def _function(self, name: str) -> Callable[..., Any]:
        function = self._found.get(name)
        if function is None:
            found = getattr(self._dll, f"fmi2{name}")
            found.restype, *found.argtypes = _TABLE[name]
            self._found[name] = function = found
        return function


def pack(base: str, values: Sequence[Value]) -> Any:
    """A C array of values of a base type (strings as UTF-8)."""
    if base == "String":
        return (c_char_p * len(values))(*(str(value).encode() for value in values))
    return (_C_TYPES[base] * len(values))(*values)


def unpack(base: str, array: Any) -> list[Value]:
    """The values of a C array; a string that is a null pointer or no UTF-8 shows as such."""
    if base != "String":
        return list(array)
    return ["<null>" if raw is None else raw.decode(errors="replace") for raw in array]
