"""``python -m congelation`` is the command ``congelation``."""

import gc
import os
import signal
from types import FrameType

__all__ = ["main"]

_INTERRUPTED = 130


def main() -> None:
    """Run the command line and exit."""
    # The imports take a second or more, and have nothing to clean up: Ctrl-C ends them at once,
    # without the traceback of whichever module is being read.
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:  # and not ignored, as in a shell's background
        signal.signal(signal.SIGINT, _end)
    # Here: a sweep's worker processes import the main module anew, and need nothing of this.
    from congelation.cli import main as command

    def ready() -> None:
        signal.signal(signal.SIGINT, before)
        for name in ("SIGTERM", "SIGHUP"):  # of batch systems, services, and closed terminals
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is signal.SIG_DFL:
                signal.signal(number, _interrupt)

    try:
        command(ready=ready)
    finally:
        # The last search for garbage takes a quarter of a second, and frees what ends anyway.
        gc.freeze()


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Do as at Ctrl-C, also where that is held back for a moment, or ignored."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.raise_signal(signal.SIGINT)


def _end(number: int, frame: FrameType | None) -> None:
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    main()
