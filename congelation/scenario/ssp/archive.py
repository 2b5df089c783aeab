"""SSP archives as files, unpacked or to be written, and the XML of SSP 1.0 in them."""

from __future__ import annotations

import hashlib
import multiprocessing.util
import re
import shutil
import tempfile
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

import fmpy
from lxml import etree

from congelation.errors import InvalidInput
from congelation.fmi.document import schema_errors
from congelation.fmi.unpack import parse_xml, unpack_archive

__all__ = [
    "ANNOTATION",
    "DESCRIPTION",
    "NAMESPACES",
    "PARAMETERS",
    "SSD",
    "Archive",
    "Contents",
    "parse",
    "tag",
    "unpack",
]

SSD = "SystemStructure.ssd"
"""The file of an archive that describes its system."""

DESCRIPTION = "SystemStructureDescription"
"""Root of that file, and name of its schema."""

PARAMETERS = "SystemStructureParameterValues"
"""Name of the schema of parameter sets, whose root is ParameterSet."""

ANNOTATION = "congelation"
"""Type of the annotation for what SSP has no place for: coupling, step, metrics, figures."""

_SCHEMAS = Path(fmpy.__file__).parent / "ssp" / "schema"
_SSP = "http://ssp-standard.org/SSP1/"
NAMESPACES = {
    "ssd": _SSP + DESCRIPTION,
    "ssv": _SSP + PARAMETERS,
    "ssc": _SSP + "SystemStructureCommon",
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
    "oms": "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
}
"""By prefix. libcosim, Ecos and OMSimulator look for these prefixes, not for the namespaces."""

# The earliest date of a ZIP archive: equal content, equal bytes.
_DATE = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class Archive:
    """An archive: the file as the user named it, and the folder where it lies unpacked."""

    file: Path
    folder: Path

    def error(self, text: str) -> InvalidInput:
        """The error to raise about something in the archive."""
        return InvalidInput(f"{self.file}: {text}")

    def named(self, error: InvalidInput) -> InvalidInput:
        """An error about a file of the archive, which names both and not where it is unpacked."""
        text = str(error).replace(f"{self.folder}/", "")
        return InvalidInput(text) if text.startswith(str(self.file)) else self.error(text)

    def find(self, source: str, what: str) -> Path:
        """The file at the URI `source`.

        Raises
        ------
        InvalidInput
            If the archive has none there; `what` is what names it.
        """
        for name in (source, unquote(source)):
            if (found := self.held(name)) is not None:
                return found
        raise self.error(f"{what}: there is no '{source}' in the archive")

    def held(self, name: str) -> Path | None:
        """The file of the archive that a text names, if it names one."""
        if not name or "\0" in name:
            return None
        try:
            found = (self.folder / name).resolve()
            return found if found.is_relative_to(self.folder) and found.is_file() else None
        except OSError:  # too long for a name
            return None


def unpack(file: Path) -> Archive:
    """Unpack an archive into a folder that is removed when the process ends.

    Raises
    ------
    InvalidInput
        If there is no such file, or if it is no archive.
    """
    if not file.is_file():
        raise InvalidInput(f"{file}: no such file; give the path of an SSP archive (.ssp)")
    folder = Path(tempfile.mkdtemp(prefix=f"{file.stem}_")).resolve()
    # Unlike atexit, this also runs at the end of a worker process, and only in its own.
    multiprocessing.util.Finalize(None, shutil.rmtree, (folder, True), exitpriority=1)
    unpack_archive(file, folder, "an SSP archive")
    return Archive(file, folder)


@dataclass
class Contents:
    """The files of an archive to be written, by name."""

    entries: dict[str, bytes] = field(default_factory=dict)

    def add(self, name: str, content: bytes) -> str:
        """Add a file under its name, or a longer one if another content has that."""
        if self.entries.get(name, content) != content:
            stem, dot, suffix = name.rpartition(".")
            name = f"{stem}_{hashlib.sha256(content).hexdigest()[:8]}{dot}{suffix}"
        self.entries[name] = content
        return name

    def write(self, target: Path) -> None:
        """Write the archive; equal contents give equal bytes."""
        with zipfile.ZipFile(target, "w") as archive:
            for name, content in sorted(self.entries.items()):
                info = zipfile.ZipInfo(name, _DATE)
                info.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(info, content)


def tag(element: str) -> str:
    """The qualified name of an element, ``ssd:System``, as lxml writes it."""
    prefix, _, name = element.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{name}"


def parse(data: bytes, schema: str, place: str) -> etree._Element:
    """The root of an XML document that is valid by a schema.

    Raises
    ------
    InvalidInput
        Beginning with `place`, if it is no XML, or not valid.
    """
    try:
        root = parse_xml(data)
    except ValueError as error:
        raise InvalidInput(f"{place}: {error}") from error
    wanted, version = _SSP + schema, root.get("version", "")
    if etree.QName(root).namespace != wanted:
        raise InvalidInput(
            f"{place}: the root is '{root.tag}', that of SSP 1.0 is of the namespace '{wanted}'"
        )
    if not version.startswith("1."):
        raise InvalidInput(f"{place}: of SSP {version or 'no version'}; SSP 1.0 is needed")
    errors = schema_errors(_SCHEMAS / f"{schema}.xsd", root)
    if errors:
        first = errors[0]
        message = re.sub(
            r"\{[^}]*\}", "", first.message
        )  # namespaces, which files do not spell out
        raise InvalidInput(f"{place}, line {first.line}: {message}")
    return root
