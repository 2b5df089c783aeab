"""An FMU as a zip archive whose bytes follow from its entries alone."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable
from pathlib import Path

__all__ = ["write_archive"]

# Zip's epoch: equal sources must give equal bytes.
_DATE = (1980, 1, 1, 0, 0, 0)
_MODE = 0o644 << 16


def write_archive(target: Path, entries: Iterable[tuple[str, bytes]]) -> None:
    """Write the entries (name, content), in their order, to the file `target`."""
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, data in entries:
            info = zipfile.ZipInfo(name, _DATE)
            info.external_attr = _MODE
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, data)
