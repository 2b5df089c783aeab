"""The bare loop with every call of an FMU replaced by one of a C function that does nothing.

What it takes is the host's part of the bare loop; the rest of that is the FMUs' own time.
"""

from __future__ import annotations

import ctypes
import ctypes.util
from collections.abc import Callable
from ctypes import c_double, c_int, c_size_t, c_void_p
from typing import Any

from benchmarks.engines.bare import Bare
from benchmarks.loop import Loop

__all__ = ["Hollow"]


class Hollow(Bare):
    """Not a simulation: the values never change."""

    def __init__(self, loop: Loop) -> None:
        super().__init__(loop)
        for instance in self.instances:
            instance.set_real = instance.get_real = _nothing(c_void_p, c_size_t, c_void_p)
            instance.step = _nothing(c_double, c_double, c_int)


def _nothing(*arguments: Any) -> Callable[..., int]:
    """fegetround, which takes nothing, does nothing, and returns 0: fmi2OK."""
    # A library object of its own, since argument types are kept on its functions.
    function = ctypes.CDLL(ctypes.util.find_library("m")).fegetround
    function.argtypes, function.restype = [c_void_p, *arguments], c_int
    found: Callable[..., int] = function
    return found
