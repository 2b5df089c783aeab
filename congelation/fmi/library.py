"""FMUs on disk and in memory: unpacked once per content, loaded by fmpy, logging captured."""

from __future__ import annotations

import ctypes
import itertools
import multiprocessing.util
import shutil
import tempfile
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from weakref import WeakValueDictionary

import fmpy
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi2 import fmi2CallbackAllocateMemoryTYPE as AllocateMemory
from fmpy.fmi2 import fmi2CallbackFreeMemoryTYPE as FreeMemory
from fmpy.logging import addLoggerProxy

from congelation.errors import InvalidInput
from congelation.fmi.description import Description

__all__ = ["ERROR", "Log", "Message", "load", "unpack"]

ERROR = 3
"""fmi2Error; fmi2Fatal is above it."""

KEPT_MESSAGES = 200
"""Messages kept per instance: enough to explain a failure, bounded in a long run."""


@dataclass(frozen=True)
class Message:
    """One message that an FMU logged."""

    status: int
    category: str
    text: str

    @property
    def line(self) -> str:
        """The text in one line."""
        return " ".join(self.text.split())


@dataclass
class Log:
    """The messages of one instance; `error` is the last one of status fmi2Error or worse."""

    messages: deque[Message] = field(default_factory=lambda: deque(maxlen=KEPT_MESSAGES))
    error: Message | None = None

    def add(self, message: Message) -> None:
        """Keep a message."""
        self.messages.append(message)
        if message.status >= ERROR:
            self.error = message

    def clear(self) -> None:
        """Forget everything."""
        self.messages.clear()
        self.error = None


def unpack(description: Description) -> Path:
    """The folder in which an FMU lies unpacked; made once per content and process."""
    if description.sha256 not in _FOLDERS:
        folder = Path(tempfile.mkdtemp(prefix=f"{description.model_identifier}_"))
        # Unlike atexit, this also runs at the end of a worker process, and only in its own.
        multiprocessing.util.Finalize(None, shutil.rmtree, (folder, True), exitpriority=1)
        try:
            fmpy.extract(description.path, folder)
        except Exception as error:  # fmpy raises bare Exception
            raise InvalidInput(f"{description.path}: cannot be unpacked: {error}") from error
        _FOLDERS[description.sha256] = folder
    return _FOLDERS[description.sha256]


def load(description: Description, name: str, log: Log) -> FMU2Slave:
    """Instantiate an FMU.

    The shared library stays loaded until the process ends, and is unloaded just before: left to
    the C library, pythonfmu's destructor runs after what it works on is gone, and aborts one
    process in some dozens at its very end.

    Parameters
    ----------
    description : Description
    name : str
        Instance name.
    log : Log
        Takes the instance's messages.

    Returns
    -------
    FMU2Slave
        Its `component` is None where the FMU refused.

    Raises
    ------
    InvalidInput
        No binary for this platform, or one that cannot be loaded.
    """
    folder = unpack(description)
    try:
        slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=description.model_identifier,
            instanceName=name,
        )
    except Exception as error:  # fmpy raises bare Exception
        raise InvalidInput(
            f"{description.path}: {error} (needed: a binary for {fmpy.platform})"
        ) from error
    multiprocessing.util.Finalize(None, fmpy.freeLibrary, (slave.dll._handle,), exitpriority=2)
    slave.callbacks = _callbacks(log, formatted=(folder / "resources/slavemodule.txt").exists())
    slave.component = slave.fmi2Instantiate(
        name.encode(),
        1,  # fmi2CoSimulation
        description.guid.encode(),
        (folder / "resources").as_uri().encode(),
        ctypes.byref(slave.callbacks),
        False,
        True,
    )
    return slave


_FOLDERS: dict[str, Path] = {}
# Of the instances that there are; a message that comes later has nobody to hear it.
_LOGS: WeakValueDictionary[int, Log] = WeakValueDictionary()
_NUMBERS = itertools.count(1)


def _text(value: bytes | None) -> str:
    return (value or b"").decode("utf-8", errors="replace")


def _dispatch(
    environment: int | None, name: bytes, status: int, category: bytes, message: bytes
) -> None:
    """Give a message to the log of its instance; `environment` is the log's number."""
    log = _LOGS.get(environment or 0)
    if log is not None:
        log.add(Message(status, _text(category), _text(message)))


# One callback for all instances: fmpy's formatting proxy remembers only the last one.
_LOGGER = fmi2CallbackLoggerTYPE(_dispatch)


def _callbacks(log: Log, *, formatted: bool) -> fmi2CallbackFunctions:
    """Callbacks of one instance.

    C programs log as printf does, and fmpy's proxy puts the arguments in. A pythonfmu FMU logs
    finished text, in which a percent sign must not be taken for a format: `formatted`.
    """
    number = next(_NUMBERS)
    _LOGS[number] = log
    callbacks = fmi2CallbackFunctions()
    callbacks.logger = _LOGGER
    callbacks.allocateMemory = AllocateMemory(fmpy.calloc)
    callbacks.freeMemory = FreeMemory(fmpy.free)
    callbacks.componentEnvironment = number
    if not formatted:
        addLoggerProxy(ctypes.byref(callbacks))
    return callbacks
