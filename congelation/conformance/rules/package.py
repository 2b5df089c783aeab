"""Rules about the archive: what section 2.3 says of the ZIP file and its directories."""

from __future__ import annotations

import re
import stat
import struct
import zipfile
from collections import Counter
from collections.abc import Iterator

from congelation.conformance.rule import NotApplicable, Rule, static
from congelation.conformance.subject import DESCRIPTION, Subject

__all__ = ["RULES"]

_DEFLATE = zipfile.ZIP_DEFLATED
_ENCRYPTED = 0x1 | 0x40  # general purpose bits 0 and 6
_STREAMED = 0x8  # general purpose bit 3
_VERSION_NEEDED = 20  # 2.0
_TOP = {
    DESCRIPTION,
    "model.png",
    "documentation",
    "sources",
    "binaries",
    "resources",
    "extra",
    "terminalsAndIcons",
}
_PLATFORMS = {
    "win32": ".dll",
    "win64": ".dll",
    "linux32": ".so",
    "linux64": ".so",
    "darwin32": ".dylib",
    "darwin64": ".dylib",
}
_TUPLE_EXTENSIONS = {"windows": ".dll", "linux": ".so", "darwin": ".dylib"}
_PNG = b"\x89PNG\r\n\x1a\n"


@static("FMI2-PACK-01", "2.3")
def readable(subject: Subject) -> Iterator[str]:
    """The FMU is an undamaged ZIP archive whose name ends in ".fmu"."""
    if subject.trouble:
        yield f"{subject.path.name} cannot be read: {subject.trouble}"
    if subject.path.suffix != ".fmu":
        yield f"the name of {subject.path.name} does not end in .fmu"


@static("FMI2-PACK-02", "2.3")
def description_at_root(subject: Subject) -> Iterator[str]:
    """modelDescription.xml lies at the root of the archive."""
    if DESCRIPTION not in subject.names:
        yield f"the archive has no {DESCRIPTION} at its root"


@static("FMI2-PACK-03", "2.3")
def compression(subject: Subject) -> Iterator[str]:
    """Every entry is stored by compression method 8 (deflate) or 0 (store)."""
    for entry in subject.entries:
        if entry.compress_type not in (_DEFLATE, zipfile.ZIP_STORED):
            yield f"{entry.filename} uses compression method {entry.compress_type}"


@static("FMI2-PACK-04", "2.3")
def plain_archive(subject: Subject) -> Iterator[str]:
    """The archive needs no more than ZIP 2.0, is not encrypted, and is not split."""
    for entry in subject.entries:
        if entry.flag_bits & _ENCRYPTED:
            yield f"{entry.filename} is encrypted"
        if entry.extract_version > _VERSION_NEEDED:
            yield f"{entry.filename} needs ZIP {entry.extract_version / 10:.1f} to extract"
        if entry.volume != 0:
            yield f"{entry.filename} lies on volume {entry.volume} of a split archive"


@static("FMI2-PACK-05", "2.3")
def paths(subject: Subject) -> Iterator[str]:
    """Paths are relative, stay inside the archive, and use forward slashes."""
    for name in subject.names:
        if "\\" in name:
            yield f"{name!r} contains a backslash"
        if name.startswith("/") or re.match("[A-Za-z]:", name):
            yield f"{name!r} is an absolute path"
        if ".." in re.split(r"[/\\]", name):
            yield f"{name!r} leads out of the archive"


@static("FMI2-PACK-06", "2.3")
def unique_entries(subject: Subject) -> Iterator[str]:
    """No path occurs twice."""
    for name, count in Counter(subject.names).items():
        if count > 1:
            yield f"{name} occurs {count} times"


@static("FMI2-PACK-07", "2.3")
def no_links(subject: Subject) -> Iterator[str]:
    """The archive contains no links."""
    for entry in subject.entries:
        if stat.S_ISLNK(entry.external_attr >> 16):
            yield f"{entry.filename} is a symbolic link"


@static("FMI2-PACK-08", "2.3")
def implementation(subject: Subject) -> Iterator[str]:
    """There are sources or binaries, in each platform's folder one named <modelIdentifier>."""
    identifier = subject.description.identifier
    if identifier is None:
        raise NotApplicable("no FMU for co-simulation: there is no <CoSimulation>")
    files = [name for name in subject.names if not name.endswith("/")]
    folders = {name.split("/")[1] for name in files if name.startswith("binaries/")}
    if not folders and not any(name.startswith("sources/") for name in files):
        yield "the archive has neither sources nor binaries"
    for folder in sorted(folders):
        extension = _PLATFORMS.get(folder) or _TUPLE_EXTENSIONS.get(folder.partition("-")[2])
        wanted = f"binaries/{folder}/{identifier}{extension}"
        if extension is None:
            yield f"binaries/{folder} is no platform of the standard"
        elif wanted not in files:
            yield f"there is no {wanted}"


@static("FMI2-PACK-09", "2.3")
def data_descriptors(subject: Subject) -> Iterator[str]:
    """General purpose bit 3 is set for deflated entries only."""
    for entry in subject.entries:
        if entry.flag_bits & _STREAMED and entry.compress_type != _DEFLATE:
            yield f"{entry.filename} is stored uncompressed with general purpose bit 3"


@static("FMI2-PACK-10", "2.3")
def top_level(subject: Subject) -> Iterator[str]:
    """Nothing lies at the top of the archive but the files and directories of the standard."""
    for name in sorted({re.split(r"[/\\]", name)[0] for name in subject.names} - _TOP):
        yield f"{name!r} at the top of the archive; additional data belongs into extra/"


@static("FMI2-PACK-11", "2.3")
def documentation(subject: Subject) -> Iterator[str]:
    """The documentation directory, if any, has its entry point index.html."""
    if not any(name.startswith("documentation/") for name in subject.names):
        raise NotApplicable("there is no documentation directory")
    if "documentation/index.html" not in subject.names:
        yield "documentation/ has no index.html"


@static("FMI2-PACK-12", "2.3")
def icon(subject: Subject) -> Iterator[str]:
    """The icon model.png, if any, is a PNG image."""
    if "model.png" not in subject.names:
        raise NotApplicable("there is no model.png")
    image = subject.read("model.png")
    if not image.startswith(_PNG) or image[12:16] != b"IHDR":
        yield "model.png is no PNG image"
    elif 0 in struct.unpack(">II", image[16:24]):
        yield "model.png is an empty image"


@static("FMI2-PACK-13", "2.3")
def source_files(subject: Subject) -> Iterator[str]:
    """The files listed under SourceFiles and those needed to build are in sources/."""
    listed = [
        element.get("name", "")
        for element in subject.root.iterfind("CoSimulation/SourceFiles/File")
    ]
    sources = [name for name in subject.names if name.startswith("sources/")]
    if not listed and not sources:
        raise NotApplicable("an FMU without sources")
    for name in listed:
        if f"sources/{name}" not in sources:
            yield f"SourceFiles lists {name}, which is not in sources/"
    if not listed and "sources/buildDescription.xml" not in sources:
        yield "there are sources, but no SourceFiles say which ones are to be compiled"


RULES: tuple[Rule, ...] = (
    readable,
    description_at_root,
    compression,
    plain_archive,
    paths,
    unique_entries,
    no_links,
    implementation,
    data_descriptors,
    top_level,
    documentation,
    icon,
    source_files,
)
