"""``python -m congelation`` is the command ``congelation``."""

import gc
import os
import signal
import sys
from types import FrameType

__all__ = ["main"]

_INTERRUPTED = 130
_ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


def main() -> None:
    """Run the command line and exit."""
    # The imports take a second or more, and have nothing to clean up: Ctrl-C ends them at once,
    # without the traceback of whichever module is being read.
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:  # and not ignored, as in a shell's background
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
    signal.signal(signal.SIGINT, before)
    for number in _ENDING:  # how schedulers and closed terminals end a job: like Ctrl-C
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _interrupt)
    try:
        command()
    finally:
        # The last search for garbage takes a quarter of a second, and frees what ends anyway.
        gc.freeze()


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Do as at Ctrl-C, also where that is ignored; it is held back where that is."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.raise_signal(signal.SIGINT)


def _end(number: int, frame: FrameType | None) -> None:
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    main()
