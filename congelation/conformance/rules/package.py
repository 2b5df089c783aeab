"""Rules about the archive: what section 2.3 says of the ZIP file and its directories."""

from __future__ import annotations

import posixpath
import re
import stat
import struct
import zipfile
from collections import Counter
from collections.abc import Iterator

from congelation.conformance.rule import Level, NotApplicable, require, static
from congelation.conformance.subject import DESCRIPTION, Subject

__all__: list[str] = []

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
_COMPILED = (".c", ".cc", ".cpp", ".cxx")
_PNG = b"\x89PNG\r\n\x1a\n"


@static("FMI2-PACK-01", "2.3", Level.VIOLATION)
def readable(subject: Subject) -> Iterator[str]:
    """The FMU is an undamaged ZIP archive whose name ends in ".fmu".

    Standard: "The extension of the ZIP file must be '.fmu'."

    Why: Importers look for that extension and read the archive whole.

    Remedy: Pack the FMU again as a ZIP archive named .fmu

    Example: A download that broke off, or Model.zip.
    """
    if subject.trouble:
        yield f"{subject.path.name} cannot be read: {subject.trouble}"
    subject.archive()
    if subject.path.suffix != ".fmu":
        yield f"the name of {subject.path.name} does not end in .fmu"


@static("FMI2-PACK-02", "2.3", Level.VIOLATION)
def description_at_root(subject: Subject) -> Iterator[str]:
    """modelDescription.xml lies at the root of the archive.

    Standard: "modelDescription.xml // Description of FMU (required file)"

    Why: An importer reads this file first, at the root of the archive.

    Remedy: Pack the content of the folder, not the folder

    Example: Model/modelDescription.xml in place of modelDescription.xml.
    """
    if DESCRIPTION not in subject.names:
        yield f"the archive has no {DESCRIPTION} at its root"


@static("FMI2-PACK-03", "2.3", Level.VIOLATION)
def compression(subject: Subject) -> Iterator[str]:
    """Every entry is stored by compression method 8 (deflate) or 0 (store).

    Standard: "The compression method for all files stored in the ZIP archive must be either 8
    (deflate), or 0 (store)."

    Why: Most importers unpack no other method.

    Remedy: Pack with deflate

    Example: An archive packed with bzip2 or LZMA.
    """
    for entry in subject.archive():
        if entry.compress_type not in (_DEFLATE, zipfile.ZIP_STORED):
            yield f"{entry.filename} uses compression method {entry.compress_type}"


@static("FMI2-PACK-04", "2.3", Level.VIOLATION)
def plain_archive(subject: Subject) -> Iterator[str]:
    """The archive needs no more than ZIP 2.0, is not encrypted, and is not split.

    Standard: "version needed to extract of the archive must not be higher than 2.0, and
    encryption must not be employed"

    Why: Unpackers of importers are simple.

    Remedy: Pack without encryption, ZIP64 and splitting

    Example: zip -e, or a ZIP64 archive.
    """
    for entry in subject.archive():
        if entry.flag_bits & _ENCRYPTED:
            yield f"{entry.filename} is encrypted"
        if entry.extract_version > _VERSION_NEEDED:
            yield f"{entry.filename} needs ZIP {entry.extract_version / 10:.1f} to extract"
        if entry.volume != 0:
            yield f"{entry.filename} lies on volume {entry.volume} of a split archive"


@static("FMI2-PACK-05", "2.3", Level.VIOLATION)
def paths(subject: Subject) -> Iterator[str]:
    r"""Paths are relative and use forward slashes.

    Standard: "backslashes are forbidden as path separator only forward slashes are allowed" (of
    the ZIP format, to which the section refers)

    Why: On Linux resources\map.csv is one file with a strange name.

    Remedy: Pack with relative paths and forward slashes

    Example: resources\map.csv, or /resources/map.csv.
    """
    subject.archive()
    for name in subject.names:
        if "\\" in name:
            yield f"{name!r} contains a backslash"
        if name.startswith("/") or re.match("[A-Za-z]:", name):
            yield f"{name!r} is an absolute path"


@static("FMI2-PACK-06", "2.3", Level.ROBUSTNESS)
def unique_entries(subject: Subject) -> Iterator[str]:
    """No path occurs twice, and none leads out of the archive.

    Standard: nothing; a host that unpacks needs paths that lie inside its folder and are written
    once.

    Why: An archive with ../ writes over files of the host's user.

    Remedy: Name every entry once, by a path without ".."

    Example: ../../home/user/.profile.
    """
    subject.archive()
    for name in subject.names:
        if ".." in re.split(r"[/\\]", name):
            yield f"{name!r} leads out of the archive"
    for name, count in Counter(subject.names).items():
        if count > 1:
            yield f"{name} occurs {count} times"


@static("FMI2-PACK-07", "2.3", Level.VIOLATION)
def no_links(subject: Subject) -> Iterator[str]:
    """The archive contains no links.

    Standard: "Links must not be used inside the ZIP archive."

    Why: Links are not unpacked on every system.

    Remedy: Store the files themselves

    Example: libfoo.so as a link to libfoo.so.1.
    """
    for entry in subject.archive():
        if stat.S_ISLNK(entry.external_attr >> 16):
            yield f"{entry.filename} is a symbolic link"


@static("FMI2-PACK-08", "2.3", Level.VIOLATION)
def implementation(subject: Subject) -> Iterator[str]:
    """There are sources or binaries, in each standard platform's folder one named
    by modelIdentifier.

    Standard: "The FMU must be distributed with at least one implementation, in other words,
    either sources or one of the binaries"; the library is named "<modelIdentifier>"

    Why: The importer finds the library by this name.

    Remedy: Name the library in each standard platform folder after modelIdentifier

    Example: binaries/linux64/libModel.so with modelIdentifier="Model".
    """
    identifiers = set(subject.description.identifiers.values())
    require(identifiers, "there is neither <CoSimulation> nor <ModelExchange>")
    files = [name for name in subject.names if not name.endswith("/")]
    folders = {name.split("/")[1] for name in files if name.startswith("binaries/")}
    if not folders and not any(name.startswith("sources/") for name in files):
        yield "the archive has neither sources nor binaries"
    for folder in sorted(folders):
        extension = _PLATFORMS.get(folder) or _TUPLE_EXTENSIONS.get(folder.partition("-")[2])
        # Vendors may add platforms, with whatever names they give to the files in them.
        for identifier in sorted(identifiers if extension else ()):
            wanted = f"binaries/{folder}/{identifier}{extension}"
            if wanted not in files:
                yield f"there is no {wanted}"


@static("FMI2-PACK-09", "2.3", Level.VIOLATION)
def data_descriptors(subject: Subject) -> Iterator[str]:
    """General purpose bit 3 is set for deflated entries only.

    Standard: "Only files stored using compression method 8 (deflate) may be stored with general
    purpose bit 3 set."

    Why: The size of a stored entry with bit 3 is unknown to a streaming reader.

    Remedy: Pack with deflate, or to a file that can be rewound

    Example: An archive written to a pipe with store.
    """
    for entry in subject.archive():
        if entry.flag_bits & _STREAMED and entry.compress_type != _DEFLATE:
            yield f"{entry.filename} is stored uncompressed with general purpose bit 3"


@static("FMI2-PACK-10", "2.3", Level.WARNING)
def top_level(subject: Subject) -> Iterator[str]:
    """Nothing lies at the top of the archive but the files and directories of the standard.

    Standard: "The ZIP archive may contain additional entries with the prefix extra/"

    Why: Entries elsewhere may collide with later versions of the standard.

    Remedy: Move additional files to extra/<reverse domain>/

    Example: notes.txt beside modelDescription.xml.
    """
    for name in sorted({re.split(r"[/\\]", name)[0] for name in subject.names} - _TOP):
        yield f"{name!r} at the top of the archive; additional data belongs into extra/"


@static("FMI2-PACK-11", "2.3", Level.WARNING)
def documentation(subject: Subject) -> Iterator[str]:
    """The documentation directory, if any, has its entry point index.html.

    Standard: "index.html // Entry point of the documentation"

    Why: Tools open this file.

    Remedy: Name the start page index.html

    Example: Documentation/readme.html alone.
    """
    require(
        any(name.startswith("documentation/") for name in subject.names),
        "there is no documentation directory",
    )
    if "documentation/index.html" not in subject.names:
        yield "documentation/ has no index.html"


@static("FMI2-PACK-12", "2.3", Level.WARNING)
def icon(subject: Subject) -> Iterator[str]:
    """The icon model.png, if any, is a PNG image.

    Standard: "model.png // Optional image file of FMU icon"

    Why: Tools show the file as an icon.

    Remedy: Store a PNG image, or none

    Example: A JPEG that is called model.png.
    """
    if "model.png" not in subject.names:
        raise NotApplicable("there is no model.png")
    image = subject.read("model.png")
    if not image.startswith(_PNG) or image[12:16] != b"IHDR":
        yield "model.png is no PNG image"
    elif 0 in struct.unpack(">II", image[16:24]):
        yield "model.png is an empty image"


@static("FMI2-PACK-13", "2.3", Level.VIOLATION)
def source_files(subject: Subject) -> Iterator[str]:
    """The files listed under SourceFiles and those needed to build are in sources/.

    Standard: "The files to be compiled [..] have to be reported in the XML file under the
    structure <ModelExchange><SourceFiles> .. and <CoSimulation><SourceFiles>"

    Why: A source FMU is built from this list.

    Remedy: List the files to be compiled under SourceFiles

    Example: sources/model.c without SourceFiles.
    """
    listed = [
        element.get("name", "")
        for kind in ("CoSimulation", "ModelExchange")
        for element in subject.root.iterfind(f"{kind}/SourceFiles/File")
    ]
    sources = [name for name in subject.names if name.startswith("sources/")]
    if not listed and not sources:
        raise NotApplicable("an FMU without sources")
    # A binary FMU may keep the list and leave the sources out.
    for name in listed if sources else ():
        if posixpath.normpath(f"sources/{name}") not in sources:
            yield f"SourceFiles lists {name}, which is not in sources/"
    compiled = [name for name in sources if name.lower().endswith(_COMPILED)]
    if compiled and not listed and "sources/buildDescription.xml" not in sources:
        yield "there are sources, but no SourceFiles say which ones are to be compiled"
