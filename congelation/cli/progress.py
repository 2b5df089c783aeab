"""The progress of a study on stderr: a bar for people, lines of JSON for logs, or nothing."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from congelation.sweep.engine import Listener, Tally
from congelation.sweep.plan import Plan

__all__ = ["Form", "shown"]

PERIOD = 1.0
"""Seconds between two lines of JSON."""


class Form(StrEnum):
    """How progress is shown."""

    BAR = "bar"
    JSON = "json"
    QUIET = "quiet"


@contextmanager
def shown(plan: Plan, form: Form) -> Iterator[Listener | None]:
    """What shows the progress of a study in some form."""
    before = Tally(plan.total - len(plan.missing), plan.total)
    if form is Form.BAR:
        with _bar() as bar:
            task = bar.add_task(
                "", total=plan.total, completed=before.done, done=before.done, failed=0, memory="0"
            )

            def show(tally: Tally) -> None:
                for notice in tally.notices:
                    bar.console.print(
                        f"congelation: {notice}", markup=False, highlight=False, soft_wrap=True
                    )
                bar.update(
                    task,
                    completed=tally.done + tally.under_way,
                    done=tally.done,
                    failed=tally.failed,
                    memory=f"{tally.memory / 1e6:.0f}",
                )

            yield show
    elif form is Form.JSON:
        yield _Lines(before)
    else:
        yield None


def _bar() -> Progress:
    return Progress(
        TextColumn("{task.fields[done]} of {task.total} runs, {task.fields[failed]} failed"),
        BarColumn(),
        TaskProgressColumn(show_speed=True),
        TimeRemainingColumn(elapsed_when_finished=True),
        TextColumn("{task.fields[memory]} MB"),
        console=Console(stderr=True),
    )


class _Lines:
    """Lines of JSON: done, total, failed, rate (1/s), eta (s, null if unknown), memory (bytes).

    What a run has to say of its steps is a line of its own: notice.
    """

    def __init__(self, before: Tally) -> None:
        self._before = before
        self._begin = time.monotonic()
        self._next = 0.0

    def __call__(self, tally: Tally) -> None:
        for notice in tally.notices:
            print(json.dumps({"notice": notice}), file=sys.stderr, flush=True)
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
