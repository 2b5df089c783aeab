"""The progress of a study in a notebook."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from congelation.errors import counted

if TYPE_CHECKING:
    from congelation.sweep.engine import Listener, Tally

__all__ = ["notebook_progress"]

PERIOD = 0.2
"""Seconds between two changes of what is shown."""


def notebook_progress() -> Listener | None:
    """What shows progress in the notebook that runs this process; None where there is none."""
    if "ipykernel" not in sys.modules:
        return None
    from IPython import get_ipython  # there with every kernel
    from IPython.display import HTML, display

    if get_ipython() is None:  # the kernel's package is there, but runs nothing here
        return None

    handle = display(HTML(""), display_id=True)
    shown = -PERIOD

    def show(tally: Tally) -> None:
        nonlocal shown
        now = time.monotonic()
        if now - shown < PERIOD and tally.done < tally.total:
            return
        shown = now
        part = tally.done + tally.under_way
        text = f"{tally.done} of {counted(tally.total, 'run')}, {tally.failed} failed"
        handle.update(HTML(f'<progress value="{part}" max="{tally.total}"></progress> {text}'))

    return show
