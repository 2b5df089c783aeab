"""The processes in which FMUs are looked at: their start, their time limit and their end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import congelation
from congelation.conformance.binding import Tape
from congelation.conformance.host import ending
from congelation.conformance.job import Job

__all__ = ["Children", "Ended"]

# Characters of what a process wrote last.
_LAST_WORDS = 300
# Seconds between two looks at a child.
_POLL = 0.2
# The part of a rule's time after which one call hangs, but no less than so many seconds.
_CALL, _SHORT = 1 / 3, 5.0


@dataclass(frozen=True)
class Ended:
    """How a child ended.

    Attributes
    ----------
    code : int or None
        Exit code; None if the child had to be killed.
    how : str
        In words, with the call in which it ended.
    said : str
        The end of its output.
    report : dict or None
        What it left; None if it left nothing.
    """

    code: int | None
    how: str
    said: str
    report: dict[str, object] | None


class Children:
    """The processes of one check.

    Parameters
    ----------
    time_limit : float
        Seconds that a process may take, times a factor of its own.
    """

    def __init__(self, time_limit: float) -> None:
        self._time_limit = time_limit
        self._running: set[int] = set()
        self._stopped = False
        self._starting = threading.Lock()

    def stop(self) -> None:
        """Kill whatever runs, and start nothing more."""
        with self._starting:
            self._stopped = True
            for group in tuple(self._running):
                _kill(group)

    def run(self, job: Job, factor: float = 1.0) -> Ended:
        """Let a process do a job, in its time."""
        limit = self._time_limit * factor
        words = Path(job.scratch) / "stderr"
        # A file and no pipe: a process that the FMU starts and leaves may hold a pipe open.
        with words.open("wb") as stderr, self._starting:
            if self._stopped:
                return Ended(None, "not done: the check was interrupted", "", None)
            process = subprocess.Popen(
                [sys.executable, "-m", "congelation.conformance.child_main", str(job.saved())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=stderr,
                cwd=job.scratch,
                env=_environment(job),
                start_new_session=True,
            )
            self._running.add(process.pid)
        try:
            code, allowed = self._wait(process, job, limit)
        finally:
            # All processes of the group, since a rule or the FMU may have started others.
            _kill(process.pid)
            process.wait()
            with self._starting:
                self._running.discard(process.pid)
        where = Tape.read(job.tape)
        if code is None:
            how = f"not done after {allowed:.3g} s (in {where or 'the rule'})"
        else:
            how = f"the process {ending(code)}" + (f" in {where}" if where else "")
        lines = words.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        left = json.loads(job.result.read_text(encoding="utf-8")) if job.result.exists() else None
        return Ended(code, how, lines[-1][-_LAST_WORDS:] if lines else "", left)

    def _wait(
        self, process: subprocess.Popen[bytes], job: Job, limit: float
    ) -> tuple[int | None, float]:
        """The exit code of a child, None if its time is up or that of a single call, and the time.

        A call may take a part of the usual limit, also in rules that may take longer in all.
        """
        of_a_call = max(self._time_limit * _CALL, min(self._time_limit, _SHORT))
        end = time.monotonic() + limit
        state, since = b"", time.monotonic()
        while (now := time.monotonic()) < end:
            with suppress(subprocess.TimeoutExpired):
                return process.wait(min(_POLL, end - now)), limit
            found = Tape.state(job.tape)
            if found != state or not Tape.read(job.tape):
                state, since = found, time.monotonic()
            elif time.monotonic() - since > of_a_call:
                return None, of_a_call
        return None, limit


def _kill(group: int) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(group, signal.SIGKILL)


def _environment(job: Job) -> dict[str, str]:
    """That of this process; the package is found, and temporary files go away with the scratch."""
    root = str(Path(congelation.__file__).parents[1])
    paths = os.pathsep.join((root, *filter(None, [os.environ.get("PYTHONPATH")])))
    temporary = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), job.scratch)
    return {**os.environ, **temporary, "PYTHONPATH": paths}
