"""Archives that may come from anyone: what kind they are, and unpacking them within bounds."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path, PurePosixPath

from lxml import etree

from congelation.errors import InvalidInput

__all__ = ["DAMAGED", "check_archive", "parse_xml", "require_no_other_kind", "unpack_archive"]

MOST_BYTES = 2 * 2**30
"""Unpacked, of all files: several times the largest FMUs there are."""

MOST_FILES = 100_000

HARMLESS_BYTES = 64 * 2**20
MOST_COMPRESSION = 100.0
"""Largest ratio of compression of an entry beyond HARMLESS_BYTES: libraries and tables shrink to a
tenth, an archive made to fill the disk to a thousandth."""

# What zipfile raises for archives that are damaged, encrypted, or of another method.
DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, OSError, RuntimeError)


def require_no_other_kind(file: Path) -> None:
    """Refuse a file that is clearly of another kind than an FMU, and say what it is for.

    Raises
    ------
    InvalidInput
    """
    if file.suffix == ".toml" and not zipfile.is_zipfile(file):
        raise InvalidInput(
            f"{file}: this is a TOML file, not an FMU; a scenario is run (congelation run {file}), "
            f"FMUs are built of a spec (congelation build {file})"
        )
    try:
        with zipfile.ZipFile(file) as archive:
            names = set(archive.namelist())
    except DAMAGED:
        return  # what is damaged may have been an FMU
    if "SystemStructure.ssd" in names and "modelDescription.xml" not in names:
        raise InvalidInput(
            f"{file}: this is an SSP archive, not an FMU; run it with: congelation run {file}"
        )


def check_archive(file: Path, kind: str) -> None:
    """Refuse an archive whose files would lie outside its folder, or fill the disk.

    Nothing is unpacked. `kind` is what it should be, for messages: ``an FMU``.

    Raises
    ------
    InvalidInput
        Naming the file and what is wrong with it.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
    except DAMAGED as error:
        raise InvalidInput(f"{file} is not {kind}: {error}") from error
    names = set()
    for entry in entries:
        # The name as stored: zipfile cuts it at a zero byte, and maps \\ on Windows alone.
        name = entry.orig_filename
        path = PurePosixPath(name)
        if path.is_absolute() or ".." in path.parts or {*name} & {"\\", ":", "\0"}:
            raise InvalidInput(
                f"{file}: '{name}' does not lie inside the archive's folder; it is not unpacked"
            )
        if name in names:
            raise InvalidInput(f"{file}: '{name}' is in the archive twice; it is not unpacked")
        names.add(name)
        if (entry.external_attr >> 16) & 0o170000 == 0o120000:
            raise InvalidInput(f"{file}: '{name}' is a symbolic link; it is not unpacked")
    size = sum(entry.file_size for entry in entries)
    packed = max(sum(entry.compress_size for entry in entries), 1)
    if len(entries) > MOST_FILES:
        raise InvalidInput(f"{file}: {len(entries)} files; at most {MOST_FILES} are unpacked")
    if size > MOST_BYTES:
        raise InvalidInput(
            f"{file}: {size / 2**30:.3g} GiB unpacked; at most {MOST_BYTES / 2**30:g} GiB are"
        )
    if size > HARMLESS_BYTES and size > MOST_COMPRESSION * packed:
        raise InvalidInput(
            f"{file}: grows to {size / packed:.0f} times its size; "
            f"at most {MOST_COMPRESSION:g} times is unpacked"
        )


def parse_xml(content: bytes) -> etree._Element:
    """The root of an XML document that may come from anyone.

    Raises
    ------
    ValueError
        It is no XML, or declares a document type, whose entities could be anything.
    """
    try:
        root = etree.fromstring(content, etree.XMLParser(resolve_entities=False, no_network=True))
    except etree.XMLSyntaxError as error:
        raise ValueError(f"no XML: {error.msg}") from error
    if root.getroottree().docinfo.internalDTD is not None:
        raise ValueError("it declares a document type; files of FMI and SSP have none")
    return root


def unpack_archive(file: Path, folder: Path, kind: str) -> None:
    """Unpack an archive, after checking it.

    Raises
    ------
    InvalidInput
        As `check_archive`; or if it is damaged.
    """
    check_archive(file, kind)
    try:
        with zipfile.ZipFile(file) as archive:
            archive.extractall(folder)
    except DAMAGED as error:
        reason = str(error).replace(f"{folder}/", "")  # which the user has not chosen
        what = "cannot be unpacked" if isinstance(error, OSError) else f"is not {kind}"
        raise InvalidInput(f"{file} {what}: {reason}") from error
