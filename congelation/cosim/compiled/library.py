"""The shared library of the compiled loop, which is built when the package is installed."""

from __future__ import annotations

import ctypes
import sysconfig
from functools import cache
from pathlib import Path

__all__ = ["VERSION", "available", "load_library", "loaded"]

VERSION = 9
"""Version of the library that fits these structures; as in loop/loop.c."""


@cache
def loaded() -> ctypes.CDLL | None:
    """The compiled loop; None where it was not built, or in another version."""
    return load_library(
        Path(__file__).parents[1].joinpath("loop" + str(sysconfig.get_config_var("EXT_SUFFIX")))
    )


def load_library(file: Path) -> ctypes.CDLL | None:
    """The compiled loop in a file; None where it is none of this version."""
    try:
        found = ctypes.CDLL(str(file))
        if found.loop_version() != VERSION:
            return None
    except (OSError, AttributeError):
        return None
    found.work_size.restype = ctypes.c_size_t
    found.work_size.argtypes = [ctypes.c_size_t] * 3
    return found


def available() -> bool:
    """Whether there is a compiled loop."""
    return loaded() is not None
