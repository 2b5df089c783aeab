"""``python -m congelation`` is the command ``congelation``."""

import gc
import os
import signal
import sys
import threading
from contextlib import suppress
from types import FrameType

__all__ = ["main"]

_INTERRUPTED = 130
_ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


def main() -> None:
    """Run the command line and exit."""
    # The imports take a second or more, and have nothing to clean up: Ctrl-C ends them at once,
    # without the traceback of whichever module is being read.
    before = signal.getsignal(signal.SIGINT)
    held = before is not signal.default_int_handler  # ignored, as in a shell's background
    if not held:
        signal.signal(signal.SIGINT, _end)
    # Imports make thousands of objects that stay: searches for garbage among them take a tenth of
    # the time of a start, and each later search would look through them anew.
    gc.disable()
    # Here: a sweep's worker processes import the main module anew, and need nothing of this.
    from congelation.cli import load
    from congelation.cli import main as command

    load(sys.argv[1:])
    gc.freeze()
    gc.enable()

    def ready() -> None:
        sys.unraisablehook = _unraisable
        signal.signal(signal.SIGINT, before)
        for number in _ENDING:  # how schedulers and closed terminals end a job: like Ctrl-C
            if signal.getsignal(number) is signal.SIG_DFL:
                signal.signal(number, _interrupt)

    try:
        command(ready=ready)
    finally:
        # What is left is the end of Python, which has nothing to say about a further Ctrl-C.
        if not held:
            signal.signal(signal.SIGINT, lambda number, frame: os._exit(_INTERRUPTED))
        # The last search for garbage takes a quarter of a second, and frees what ends anyway.
        gc.freeze()
        # Where Ctrl-C passed through code that was compiled at run time, as that of a dataclass,
        # Python would end by the signal in place of the exit code, unless more such code is run.
        exec("")


def _unraisable(found: "sys.UnraisableHookArgs") -> None:
    """Interrupt again where Ctrl-C met a finalizer, out of which no exception can come."""
    if found.exc_type is KeyboardInterrupt:
        # Later and not here, where it could not be raised either.
        threading.Timer(AGAIN, os.kill, (os.getpid(), signal.SIGINT)).start()
    else:
        sys.__unraisablehook__(found)


AGAIN = 0.01
"""Seconds after which Ctrl-C is tried again."""


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Do as at Ctrl-C, also where that is ignored; it is held back where that is."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.raise_signal(signal.SIGINT)


def _end(number: int, frame: FrameType | None) -> None:
    with suppress(OSError):  # nobody may read it
        os.write(2, b"congelation: interrupted: nothing was begun\n")
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    main()
