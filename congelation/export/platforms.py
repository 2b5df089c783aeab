"""The platforms for which native FMUs are built, and the compilers that build for them.

gcc, or the compiler that the environment variable CC names, builds for the machine that it runs
on. ziglang (the extra native-platforms) carries a C compiler with the libraries of every platform
below, so any of them can be built for anywhere.
"""

from __future__ import annotations

import os
import platform
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from congelation.errors import CongelationError, InvalidInput

__all__ = ["PLATFORMS", "Platform", "chosen_platforms", "library"]


@dataclass(frozen=True)
class Platform:
    """A system that loads an FMU.

    Attributes
    ----------
    name : str
        What ``--platform`` calls it.
    folder, extension : str
        Where its library lies in binaries/ (FMI 2.0.4, section 2.3), and the end of its name.
    targets : tuple of str
        What ziglang compiles for; the libraries of several are put into one file.
    apart : bool
        Whether it gets an FMU of its own. A 64-bit ARM Linux has no name in FMI 2.0: importers
        there look for linux64, which is that of another processor in the other FMU.
    """

    name: str
    folder: str
    extension: str
    targets: tuple[str, ...]
    apart: bool = False


PLATFORMS: Mapping[str, Platform] = {
    p.name: p
    for p in (
        # glibc 2.17 is that of the oldest systems in use: binaries against it run on all later.
        Platform("linux64", "linux64", ".so", ("x86_64-linux-gnu.2.17",)),
        Platform("win64", "win64", ".dll", ("x86_64-windows-gnu",)),
        Platform("aarch64-linux", "linux64", ".so", ("aarch64-linux-gnu.2.17",), apart=True),
        Platform("darwin64", "darwin64", ".dylib", ("x86_64-macos", "aarch64-macos"), apart=True),
    )
}
# Each operation is rounded by itself, as in Python; only the functions of FMI are exported.
_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-fvisibility=hidden")
# What every step goes through is compiled as one unit with the model: its sizes are constants
# there, and small functions are inlined. A step takes seven eighths of the time it takes otherwise.
_UNIT = ("model.c", "profiles.c", "variables.c", "integrator.c", "exchange.c", "fmi2.c")
_UNIT_FLAGS = ("-O3",)
_EXTRA = "native-platforms"


def chosen_platforms(names: Sequence[str]) -> tuple[Platform, ...]:
    """The platforms of names, each once; of none, linux64.

    Raises
    ------
    InvalidInput
        There is no such platform.
    """
    for name in names:
        if name not in PLATFORMS:
            raise InvalidInput(
                f"--platform '{name}' is not known; valid: {', '.join(map(repr, PLATFORMS))}"
            )
    return tuple(PLATFORMS[name] for name in dict.fromkeys(names or ("linux64",)))


def library(name: str, layer: Mapping[str, bytes], model: bytes, target: Platform) -> bytes:
    """The shared library of a model over the layer.

    Parameters
    ----------
    name : str
        The FMU, for messages.
    layer : mapping of str to bytes
        C files and headers that all models share; what no step goes through
        is compiled once.
    model : bytes
        The C file of the model.
    target : Platform
        Where it is to run.

    Raises
    ------
    CongelationError
        The compiler that is needed is not here, or it failed.
    """
    compilers = _compilers(name, target)
    try:
        slices = [_linked(compiler, layer, model) for compiler in compilers]
    except _CompilerError as error:
        raise CongelationError(f"{name}: {error}") from error
    return slices[0] if len(slices) == 1 else _universal(slices)


def _compilers(name: str, target: Platform) -> list[tuple[str, ...]]:
    """The command of a compiler for each target of a platform."""
    given = os.environ.get("CC")
    own = target.name == "linux64"
    if find_spec("ziglang") is not None and not (own and given):
        zig = (sys.executable, "-m", "ziglang", "cc")
        return [(*zig, "-target", triple) for triple in target.targets]
    if not own:
        raise CongelationError(
            f"{name}: for {target.name} it is compiled by ziglang, which is not installed; "
            f"pip install 'congelation[{_EXTRA}]'"
        )
    compiler = tuple((given or "gcc").split())
    # Elsewhere gcc would compile, but for another system than the folder of the library says.
    here = sys.platform == "linux" and platform.machine() in ("x86_64", "AMD64")
    if not here or not compiler or shutil.which(compiler[0]) is None:
        raise CongelationError(
            f"{name}: a native FMU is compiled on 64-bit Linux by '{given or 'gcc'}', which is not "
            "here; install gcc, or name a C compiler by the environment variable CC, or "
            f"pip install 'congelation[{_EXTRA}]'"
        )
    return [compiler]


def _linked(compiler: tuple[str, ...], layer: Mapping[str, bytes], model: bytes) -> bytes:
    apart = {file: data for file, data in layer.items() if file not in _UNIT}
    objects = dict(_objects(compiler, tuple(apart.items())))
    given = {file: data for file, data in layer.items() if file.endswith(".h") or file in _UNIT}
    unit = "".join(f'#include "{file}"\n' for file in _UNIT).encode("utf-8")
    given |= {**objects, "model.c": model, "unit.c": unit}
    options = [*_UNIT_FLAGS, "-shared", "-s", "unit.c", *objects, "-lm", "-o", "library.bin"]
    return _compiled(compiler, given, options, "library.bin")["library.bin"]


@lru_cache(maxsize=8)
def _objects(
    compiler: tuple[str, ...], layer: tuple[tuple[str, bytes], ...]
) -> tuple[tuple[str, bytes], ...]:
    """The object files of what is not in the unit, which are the same for all FMUs of a build."""
    files = [file for file, _ in layer if file.endswith(".c")]
    # One by one: for Windows, ziglang takes several files as parts of one object.
    return tuple(
        item
        for file in files
        for item in _compiled(compiler, dict(layer), ["-c", file], "*.o*").items()
    )


class _CompilerError(Exception):
    """The compiler failed; its first error."""


def _compiled(
    compiler: tuple[str, ...], files: Mapping[str, bytes], options: Sequence[str], results: str
) -> dict[str, bytes]:
    """What a compiler makes of `files` in an empty folder: the files that match `results`."""
    with tempfile.TemporaryDirectory(prefix="congelation_native_") as temporary:
        folder = Path(temporary)
        for file, data in files.items():
            (folder / file).write_bytes(data)
        command = [*compiler, *_FLAGS, *options]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            lines = done.stderr.splitlines()
            reason = next((line for line in lines if "error" in line), "no reason")
            raise _CompilerError(f"{' '.join(compiler)} failed: {reason}")
        return {file.name: file.read_bytes() for file in sorted(folder.glob(results))}


# -- Mach-O ---------------------------------------------------------------------------------------

_FAT, _THIN = 0xCAFEBABE, 0xFEEDFACF
# Slices begin at multiples of 2**14, the size of a page on Apple's processors.
_PAGE = 14


def _universal(slices: Sequence[bytes]) -> bytes:
    """One macOS library of those of several processors.

    A head of big-endian numbers (mach-o/fat.h: magic, count, and for each slice processor, kind of
    it, place, size, alignment), then the slices as they are.
    """
    place, head, body = 1 << _PAGE, struct.pack(">2I", _FAT, len(slices)), b""
    for part in slices:
        magic, processor, kind = struct.unpack_from("<3I", part)
        if magic != _THIN:
            raise ValueError("the compiler made no 64-bit Mach-O file")
        start = place + len(body)
        head += struct.pack(">5I", processor, kind, start, len(part), _PAGE)
        body += part + bytes(-len(part) % place)
    return head + bytes(place - len(head)) + body
