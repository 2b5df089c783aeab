"""The progress of a sweep on stderr: a bar for people, lines of JSON for logs, or nothing."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from congelation.sweep.batch import Tally
from congelation.sweep.sweep_plan import Plan

__all__ = ["Form", "shown"]

Listener = Callable[[Tally], None]

PERIOD = 1.0
"""Seconds between two lines of JSON."""


class Form(StrEnum):
    """How progress is shown."""

    BAR = "bar"
    JSON = "json"
    QUIET = "quiet"


@contextmanager
def shown(plan: Plan, form: Form) -> Iterator[Listener | None]:
    """Show what the listener hears."""
    total = len(plan.run_ids)
    before = Tally(total - len(plan.missing), total)
    if form is Form.BAR:
        with _bar() as bar:
            task = bar.add_task("", total=total, completed=before.done, failed=0, memory="0")
            yield lambda tally: bar.update(
                task,
                completed=tally.done,
                failed=tally.failed,
                memory=f"{tally.memory / 1e6:.0f}",
            )
    elif form is Form.JSON:
        yield _Lines(before)
    else:
        yield None


def _bar() -> Progress:
    return Progress(
        TextColumn("{task.completed} of {task.total} runs, {task.fields[failed]} failed"),
        BarColumn(),
        TaskProgressColumn(show_speed=True),
        TimeRemainingColumn(elapsed_when_finished=True),
        TextColumn("{task.fields[memory]} MB"),
        console=Console(stderr=True),
    )


class _Lines:
    """Lines of JSON: done, total, failed, rate (1/s), eta (s, null if unknown), memory (bytes)."""

    def __init__(self, before: Tally) -> None:
        self._before = before
        self._begin = time.monotonic()
        self._next = 0.0

    def __call__(self, tally: Tally) -> None:
        now = time.monotonic()
        if now < self._next and tally.done < tally.total:
            return
        self._next = now + PERIOD
        rate = (tally.done - self._before.done) / max(now - self._begin, 1e-9)
        line = {
            "done": tally.done,
            "total": tally.total,
            "failed": tally.failed,
            "rate": round(rate, 3),
            "eta": round((tally.total - tally.done) / rate, 1) if rate > 0.0 else None,
            "memory": tally.memory,
        }
        print(json.dumps(line), file=sys.stderr, flush=True)
