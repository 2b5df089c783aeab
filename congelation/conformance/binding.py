"""The C functions of an FMI 2.0 co-simulation FMU, called raw through ctypes.

Nothing is checked or smoothed over on the way: a rule has to be able to make every wrong call,
and sees the status and the log messages exactly as they come. Before each call the name of the
function is written to a tape (a mapped file), so that whoever finds the process dead knows
which call killed it.
"""

from __future__ import annotations

import _ctypes  # the only door to dlclose
import ctypes
import mmap
from collections.abc import Callable, Sequence
from ctypes import POINTER, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

from congelation.conformance.description import Value

__all__ = [
    "FUNCTIONS",
    "Callbacks",
    "Library",
    "LogMessage",
    "Logger",
    "Status",
    "Tape",
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
Logger = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)

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


_TABLE = _functions()

# Names without the prefix "fmi2", of the common and the co-simulation part (section 4.2.4).
FUNCTIONS: tuple[str, ...] = tuple(_TABLE)


class Tape:
    """The name of the function being called, in a file that outlives the process.

    Parameters
    ----------
    path : Path
        Created with `LENGTH` bytes.
    """

    LENGTH = 64

    def __init__(self, path: Path) -> None:
        path.write_bytes(bytes(self.LENGTH))
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), self.LENGTH)

    def write(self, text: str) -> None:
        """Note what is about to happen; "" for nothing in particular."""
        self._map[:] = text.encode()[: self.LENGTH].ljust(self.LENGTH, b"\0")

    @staticmethod
    def read(path: Path) -> str:
        """What a process wrote last, "" for nothing."""
        return path.read_bytes().rstrip(b"\0").decode() if path.exists() else ""


@dataclass(frozen=True)
class LogMessage:
    """One call of the logger; None stands for a null pointer."""

    environment: int | None
    instance: str | None
    status: int
    category: str | None
    text: str | None


class Library:
    """The shared library of an FMU.

    Parameters
    ----------
    path : Path
        Of the shared library.
    tape : Tape
        Where each call is noted.

    Raises
    ------
    OSError
        The library cannot be loaded.
    """

    def __init__(self, path: Path, tape: Tape) -> None:
        self.path = path
        self._tape = tape
        tape.write(f"dlopen({path.name})")
        self._dll = ctypes.CDLL(str(path))
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
        self._tape.write(f"fmi2{name}")
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
