"""Where the data files of the package are, and whether files can be written somewhere."""

from __future__ import annotations

import importlib.resources
import tempfile
from pathlib import Path

from congelation.errors import InvalidInput

__all__ = ["check_file", "check_folder", "shipped"]


def check_folder(option: str, folder: Path) -> None:
    """Make `folder`, if need be, and refuse it where it takes no files.

    Parameters
    ----------
    option : str
        What gave it, for the message: ``--out``.
    folder : Path

    Raises
    ------
    InvalidInput
        If it cannot be made, or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Permissions alone do not tell: not of a file system such as /proc, nor to root.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InvalidInput(
            f"{option} {folder}: no files can be written there ({error.strerror}); "
            "give a folder that exists or can be made"
        ) from error


def check_file(option: str, file: Path) -> None:
    """Refuse `file` where it is a folder, or its own takes no files; see `check_folder`."""
    if file.is_dir():
        raise InvalidInput(f"{option} {file}: this is a folder; give the name of a file")
    check_folder(option, file.parent)


def shipped(name: str) -> Path:
    """The folder `name` of those that come with the package: fmu_src, specs or scenarios.

    In a wheel they are inside the package, in a checkout at its top level.
    """
    package = Path(str(importlib.resources.files("congelation")))
    inside = package / "shipped" / name
    return inside if inside.is_dir() else package.parent / name
