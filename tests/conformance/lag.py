"""Building the test FMU, whole or broken: with a mutation, or edited after packing."""

from __future__ import annotations

import struct
import subprocess
import zipfile
import zlib
from collections.abc import Callable
from importlib.resources import as_file, files
from pathlib import Path

from congelation.conformance.job import platform_folder

__all__ = ["SOURCES", "Entries", "build", "compiled", "header", "read_entries", "write_archive"]

SOURCES = Path(__file__).parent / "fmu"

# Contents of the archive by name.
Entries = dict[str, bytes]


def header(name: str) -> str:
    """One of the header files of FMI."""
    return (files("fmpy") / "c-code" / name).read_text(encoding="utf-8")


# Mutations of how the library is linked. All others are names that a compiled library looks for
# behind this mark.
_LINKED = ("function_missing", "library_missing", "libm_left_to_host", "needs_its_host")
_MARK = b"chosen mutations: "


def compiled(folder: Path, mutation: str = "") -> bytes:
    """The shared library, with mutations (separated by blanks) or none."""
    words = mutation.split()
    linked = [name for name in _LINKED if name in words]
    target = folder / f"lag-{'-'.join(linked) or 'plain'}.so"
    if not target.is_file():
        _compile(target, linked)
    library = bytearray(target.read_bytes())
    text = "".join(f"{name} " for name in words if name not in linked).encode()
    place = library.index(_MARK) + len(_MARK)
    assert not any(library[place : place + len(text) + 1]), "there is no room for these names"
    library[place : place + len(text)] = text
    return bytes(library)


def _compile(target: Path, linked: list[str]) -> None:
    flags = [f"-DMUTATION_{name}=1" for name in linked] or ["-Wall", "-Wextra", "-Werror"]
    libraries = [] if "libm_left_to_host" in linked else ["-lm"]
    with as_file(files("fmpy") / "c-code") as headers:
        command = ["cc", "-shared", "-fPIC", "-O0", *flags, f"-I{headers}"]
        if "library_missing" in linked:
            # Linked to another library, which is then taken away.
            gone = target.with_name("libgone.so")
            subprocess.run(["cc", "-shared", "-o", gone, "-x", "c", "/dev/null"], check=True)
            libraries += ["-Wl,--no-as-needed", f"-L{target.parent}", "-lgone"]
        subprocess.run([*command, SOURCES / "lag.c", "-o", target, *libraries], check=True)


def read_entries(library: bytes) -> Entries:
    """The contents of the correct FMU around a shared library."""
    names = ("modelDescription.xml", "resources/feedthrough.txt", "documentation/index.html")
    entries = {name: (SOURCES / name).read_bytes() for name in names}
    entries["sources/lag.c"] = (SOURCES / "lag.c").read_bytes()
    entries["model.png"] = _dot()
    entries[f"binaries/{platform_folder()}/lag.so"] = library
    return entries


def _dot() -> bytes:
    """A PNG image of one black pixel."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        check = zlib.crc32(kind + data)
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", check)

    header = struct.pack(">IIBBBBB", 1, 1, 8, 0, 0, 0, 0)
    pixels = zlib.compress(b"\0\0")
    start = b"\x89PNG\r\n\x1a\n"
    return start + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def write_archive(path: Path, entries: Entries) -> Path:
    """Pack an FMU as the standard wants it."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return path


def build(
    folder: Path,
    library: bytes,
    *,
    edit: Callable[[Entries], Entries] | None = None,
    name: str = "lag.fmu",
) -> Path:
    """An FMU in a folder, its contents edited first."""
    entries = read_entries(library)
    return write_archive(folder / name, edit(entries) if edit else entries)
