"""The process in which one dynamic rule looks at one FMU.

Reads a `Job` as JSON from standard input and leaves the result in the job's scratch directory.
Standard output and error belong to the FMU, which may print what it likes.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from congelation.conformance.bench import Bench, Job
from congelation.conformance.rule import judge
from congelation.conformance.rules import BY_ID
from congelation.conformance.tasks import TASKS

__all__ = ["main"]


def main() -> None:
    """Do the job on standard input."""
    job = Job(**json.load(sys.stdin))
    os.chdir(job.scratch)
    bench = Bench(job)
    if job.task:
        _leave(job.result, TASKS[job.task](bench))
        os._exit(0)
    rule = BY_ID[job.rule]
    outcome, lines = judge(rule, bench, prepare=None if rule.bare else bench.plain_run)
    report = {"outcome": outcome.name, "lines": lines, "notes": bench.notes}
    _leave(job.result, json.dumps(report))
    if not rule.ends_normally:
        # How the process would end is the business of the rules that say so.
        sys.stdout.flush()
        os._exit(0)


def _leave(path: Path, text: str) -> None:
    """Write a result so that a reader finds all of it or nothing."""
    part = path.with_suffix(".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


if __name__ == "__main__":
    main()
