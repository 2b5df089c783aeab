"""SSP archives as files: one that lies unpacked, and what is to become one."""

from __future__ import annotations

import hashlib
import multiprocessing.util
import shutil
import tempfile
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

from congelation.errors import InvalidInput

__all__ = ["Archive", "Contents", "unpack"]

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

    def find(self, source: str, what: str) -> Path:
        """The file at the URI `source`.

        Raises
        ------
        InvalidInput
            If the archive has none there; `what` is what names it.
        """
        for name in (source, unquote(source)):
            found = (self.folder / name).resolve()
            if found.is_relative_to(self.folder) and found.is_file():
                return found
        raise self.error(f"{what}: there is no '{source}' in the archive")


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
    try:
        with zipfile.ZipFile(file) as archive:
            archive.extractall(folder)
    except (zipfile.BadZipFile, NotImplementedError, OSError) as error:
        raise InvalidInput(f"{file}: is no SSP archive: {error}") from error
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
