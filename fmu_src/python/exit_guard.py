"""Keeps a host from aborting when it exits after running an FMU of PythonFMU 0.7 on Linux.

The wrapper's library holds its state in a static shared pointer and clears the same pointer once
more in a function that the loader runs after the static destructors. That second time it counts
down a reference in memory freed just before. glibc keeps a freed block of this size untouched
while its cache of seven such blocks has room; otherwise the block joins a list that the count
damages, and the process aborts ("corrupted unsorted chunks", "corrupted double-linked list").

So room is made: functions registered now run at exit before the library's destructors, and each
takes one block of that size out of the cache. Where the cache is empty, glibc fills it from its
other free blocks of the size, so as many have to be taken as there may be. What is registered
between the library and these functions runs between them, too late: OpenSSL, which the standard
library's hashes load, frees a hundred such blocks. So this module is the first that the package
imports, and registers at once.
"""

from __future__ import annotations

import ctypes
import sys

__all__ = ["guard"]

# Size of the block that the wrapper allocates for its state: a control block of 16 bytes and the
# state itself.
BLOCK = 128
# Many times what was found free; together they take 140 kB of a process that is ending.
BLOCKS = 1000

_guarded = set()


def guard(library):
    """Guard a further copy of the library, once; `library` is any name that is unique to it."""
    if library not in _guarded:
        _guarded.add(library)
        _register()


def _register():
    if sys.platform != "linux":
        return
    try:
        libc = ctypes.CDLL(None)
        register = libc["__cxa_atexit"]
        malloc = ctypes.cast(libc.malloc, ctypes.c_void_p)
    except (OSError, AttributeError):
        # A C library without these functions has no such cache either.
        return
    for _ in range(BLOCKS):
        register(malloc, ctypes.c_void_p(BLOCK), None)


_register()
