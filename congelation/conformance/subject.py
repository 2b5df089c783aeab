"""An FMU as the static rules see it: an archive, its XML, and what the XML says."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from lxml import etree

from congelation.conformance.description import Description, Unreadable, read_description
from congelation.conformance.rule import NotApplicable

__all__ = ["DESCRIPTION", "Subject", "open_subject"]

DESCRIPTION = "modelDescription.xml"


@dataclass(frozen=True)
class Subject:
    """The archive or the unpacked FMU and, as far as they can be had, its contents.

    Attributes
    ----------
    path : Path
        The file.
    entries : tuple of ZipInfo
        The central directory; empty if the file is no archive.
    trouble : str
        Why the archive cannot be read, "" if it can.
    xml : bytes or None
        modelDescription.xml.
    """

    path: Path
    entries: tuple[zipfile.ZipInfo, ...]
    trouble: str
    xml: bytes | None

    @property
    def unpacked(self) -> bool:
        """Whether the FMU is a directory."""
        return self.path.is_dir()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the entries, as stored; of a directory, its files."""
        if self.unpacked:
            files = (path for path in sorted(self.path.rglob("*")) if path.is_file())
            return tuple(path.relative_to(self.path).as_posix() for path in files)
        return tuple(entry.orig_filename for entry in self.entries)

    def archive(self) -> tuple[zipfile.ZipInfo, ...]:
        """The entries, for rules about the archive.

        Raises
        ------
        NotApplicable
            The FMU is a directory.
        """
        if self.unpacked:
            raise NotApplicable("an unpacked FMU has no archive")
        return self.entries

    @cached_property
    def description(self) -> Description:
        """What modelDescription.xml says.

        Raises
        ------
        NotApplicable
            It cannot be read, which is the finding of another rule.
        """
        try:
            return read_description(self._xml(), etree.fromstring)
        except Unreadable as error:
            raise NotApplicable(f"{error}; see FMI2-XML-01 and FMI2-XML-02") from error

    @cached_property
    def root(self) -> etree._Element:
        """The root element, for what `Description` leaves out."""
        try:
            return etree.fromstring(self._xml())
        except etree.XMLSyntaxError as error:
            raise NotApplicable(f"{DESCRIPTION} is not well-formed; see FMI2-XML-01") from error

    def read(self, name: str) -> bytes:
        """The content of an entry."""
        if self.unpacked:
            return (self.path / name).read_bytes()
        with zipfile.ZipFile(self.path) as archive:
            return archive.read(name)

    def _xml(self) -> bytes:
        if self.xml is None:
            raise NotApplicable(f"there is no {DESCRIPTION}; see FMI2-PACK-02")
        return self.xml


def open_subject(path: Path) -> Subject:
    """Look into a file; trouble is kept, not raised."""
    if path.is_dir():
        inside = path / DESCRIPTION
        return Subject(path, (), "", inside.read_bytes() if inside.is_file() else None)
    try:
        with zipfile.ZipFile(path) as archive:
            entries = tuple(archive.infolist())
            damaged = None
            try:
                damaged = archive.testzip()
                xml = archive.read(DESCRIPTION) if DESCRIPTION in archive.namelist() else None
            except (RuntimeError, NotImplementedError) as error:
                # An encrypted entry, or a compression that this Python lacks.
                return Subject(path, entries, str(error), None)
    except (OSError, zipfile.BadZipFile) as error:
        return Subject(path, (), str(error), None)
    return Subject(path, entries, f"entry {damaged} is damaged" if damaged else "", xml)
