"""Where the data files of the package are, and files that are written where the user wants them."""

from __future__ import annotations

import importlib.resources
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from congelation.errors import CongelationError, InvalidInput

__all__ = [
    "StoreError",
    "check_file",
    "check_folder",
    "discard",
    "name_of",
    "replace_whole",
    "shipped",
    "write_whole",
]


class StoreError(CongelationError):
    """A file could not be written."""


def replace_whole(file: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a temporary file beside `file`, then rename it into place.

    A link stays, and what it leads to is replaced; a device or a pipe is written to.

    Raises
    ------
    StoreError
        If the file cannot be written: no space, no permission.
    """
    if file.is_symlink():
        file = file.resolve()
    temporary = file.with_name(f".{file.name}.{os.getpid()}.tmp")
    try:
        if file.exists() and not file.is_file() and not file.is_dir():
            write(file)
            return
        file.parent.mkdir(parents=True, exist_ok=True)
        write(temporary)
        temporary.replace(file)
    except OSError as error:
        raise StoreError(f"{file} cannot be written: {error}") from error
    finally:
        discard(temporary)


def write_whole(file: Path, content: str | bytes) -> None:
    """Write a file as `replace_whole` does, a text in UTF-8."""
    data = content.encode("utf-8") if isinstance(content, str) else content
    replace_whole(file, lambda temporary: temporary.write_bytes(data))


def name_of(file: Path) -> str:
    """What results of a scenario or spec are called: its name, or that of its folder.

    All projects that `congelation new` writes have a ``scenario.toml`` and a ``spec.toml``, whose
    names tell them from no other.
    """
    if file.name in ("scenario.toml", "spec.toml"):
        return file.resolve().parent.name or file.stem
    return file.stem


def discard(file: Path) -> None:
    """Remove a file, if that can be done."""
    try:
        file.unlink(missing_ok=True)
    except OSError:  # the error that brought us here says why; this one would only hide it
        return


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
