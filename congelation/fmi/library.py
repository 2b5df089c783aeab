"""FMUs on disk and in memory: unpacked once per content, loaded by fmpy, logging captured."""

from __future__ import annotations

import ctypes
import itertools
import multiprocessing.util
import shutil
import tempfile
import zipfile
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from weakref import WeakValueDictionary

import fmpy
from fmpy.fmi2 import FMU2Model, FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi2 import fmi2CallbackAllocateMemoryTYPE as AllocateMemory
from fmpy.fmi2 import fmi2CallbackFreeMemoryTYPE as FreeMemory
from fmpy.logging import addLoggerProxy

from congelation.errors import InvalidInput, one_line
from congelation.fmi.description import Description
from congelation.fmi.unpack import unpack_archive

__all__ = [
    "DISCARD",
    "ERROR",
    "FATAL",
    "KEPT",
    "PENDING",
    "STATUS_NAMES",
    "WARNING",
    "Log",
    "Message",
    "binaries_of",
    "binary",
    "load",
    "unpack",
]

WARNING, DISCARD, ERROR, FATAL, PENDING = 1, 2, 3, 4, 5
"""Values of fmi2Status."""

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
        """The text in one line, what a terminal would obey in it escaped."""
        return one_line(self.text)


@dataclass
class Kept:
    """Where this process keeps the messages of its instances, if anywhere.

    Parameters
    ----------
    file : Path or None
        Absolute, as an FMU may change the working directory.
    run : str
        What the lines begin with.
    """

    file: Path | None = None
    run: str = ""


KEPT = Kept()

STATUS_NAMES = ("fmi2OK", "fmi2Warning", "fmi2Discard", "fmi2Error", "fmi2Fatal", "fmi2Pending")


@dataclass
class Log:
    """The messages of one instance.

    Attributes
    ----------
    name : str
        Of the component.
    time : float
        Communication point of the latest step, in seconds.
    error : Message or None
        The last one of status fmi2Error or worse.
    warnings, refusals : int
        How many there were of status fmi2Warning, and of fmi2Discard or worse.
    """

    name: str = ""
    time: float = 0.0
    messages: deque[Message] = field(default_factory=lambda: deque(maxlen=KEPT_MESSAGES))
    error: Message | None = None
    warnings: int = 0
    refusals: int = 0

    def add(self, message: Message) -> None:
        """Keep a message."""
        self.messages.append(message)
        self.warnings += message.status == WARNING
        self.refusals += DISCARD <= message.status <= FATAL
        if message.status >= ERROR:
            self.error = message
        if KEPT.file is not None:
            line = f"{KEPT.run} {self.name} {self.time:.9g} {STATUS_NAMES[message.status]} "
            # Opened for each message: workers share the file, and lines are written whole.
            with KEPT.file.open("a", encoding="utf-8") as file:
                file.write(f"{line}{message.category}: {message.line}\n")

    def clear(self) -> None:
        """Forget everything."""
        self.messages.clear()
        self.error = None
        self.warnings = self.refusals = 0


def unpack(description: Description) -> Path:
    """The folder in which an FMU lies unpacked; made once per content and process."""
    if description.sha256 not in _FOLDERS:
        folder = Path(tempfile.mkdtemp(prefix=f"{description.model_identifier}_"))
        # Unlike atexit, this also runs at the end of a worker process, and only in its own.
        multiprocessing.util.Finalize(None, shutil.rmtree, (folder, True), exitpriority=1)
        unpack_archive(description.path, folder, "an FMU")
        _FOLDERS[description.sha256] = folder
    return _FOLDERS[description.sha256]


def binaries_of(path: Path) -> tuple[str, ...]:
    """The binaries in an FMU by platform and file, ``linux64/Plant.so``."""
    with zipfile.ZipFile(path) as archive:
        parts = [PurePosixPath(name).parts for name in archive.namelist()]
    return tuple(sorted("/".join(p[1:]) for p in parts if len(p) == 3 and p[0] == "binaries"))


def binary(identifier: str) -> str:
    """The binary that this machine needs of a model, as `binaries_of` names it."""
    return f"{fmpy.platform}/{identifier}{fmpy.sharedLibraryExtension}"


def load(
    description: Description, name: str, log: Log, *, exchange: bool = False
) -> FMU2Slave | FMU2Model:
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
    exchange : bool
        For model exchange, rather than co-simulation.

    Returns
    -------
    FMU2Slave or FMU2Model
        Its `component` is None where the FMU refused.

    Raises
    ------
    InvalidInput
        No binary for this platform, or one that cannot be loaded.
    """
    # Not the whole path: an FMU of an archive lies where the user has put nothing.
    what = f"component '{name}': {description.path.name}"
    folder = unpack(description)
    is_python = _claim_module(folder, description)
    kind, identifier = FMU2Slave, description.model_identifier
    if exchange:
        if description.equations is None:
            raise InvalidInput(f"{what} offers no model exchange")
        kind, identifier = FMU2Model, description.equations.model_identifier
    try:
        slave = kind(
            guid=description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=identifier,
            instanceName=name,
        )
    except Exception as error:  # fmpy raises bare Exception
        binaries, wanted = binaries_of(description.path), binary(identifier)
        held = ", ".join(binaries) or "none at all"
        if wanted not in binaries:
            raise InvalidInput(f"{what} has no binary {wanted}; there is {held}") from error
        raise InvalidInput(f"{what}: {wanted} cannot be loaded: {error}") from error
    multiprocessing.util.Finalize(None, fmpy.freeLibrary, (slave.dll._handle,), exitpriority=2)
    slave.callbacks = _callbacks(log, formatted=is_python)
    slave.component = slave.fmi2Instantiate(
        name.encode(),
        0 if exchange else 1,  # fmi2ModelExchange, fmi2CoSimulation
        description.guid.encode(),
        (folder / "resources").as_uri().encode(),
        ctypes.byref(slave.callbacks),
        False,
        True,
    )
    return slave


def _claim_module(folder: Path, description: Description) -> bool:
    """Whether this is an FMU of pythonfmu; note the name of its module.

    All Python FMUs of a process share one interpreter, which keeps modules by their names: of two
    that differ, the first one loaded would be used for both.

    Raises
    ------
    InvalidInput
        Another FMU has brought another module of that name.
    """
    named = folder / "resources/slavemodule.txt"
    if not named.exists():
        return False
    name = named.read_text().strip()
    source = folder / "resources" / f"{name}.py"
    content = source.read_bytes() if source.is_file() else b""
    first, known = _MODULES.setdefault(name, (description.path, content))
    if known != content:
        raise InvalidInput(
            f"{description.path} and {first} are Python FMUs with different modules of one name, "
            f"'{name}.py', of which a process can load only the first; rename the module of one "
            "and build it again"
        )
    return True


_FOLDERS: dict[str, Path] = {}
# Of Python FMUs that were loaded: the module's name, whose it was, and its source.
_MODULES: dict[str, tuple[Path, bytes]] = {}
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
