"""An SSP archive, unpacked."""

from __future__ import annotations

import multiprocessing.util
import shutil
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

from congelation.errors import InvalidInput

__all__ = ["Archive", "unpack"]


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
