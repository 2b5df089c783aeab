"""The processes in which FMUs are looked at: their start, their time limit and their end.

They are forks of one process of Python that has loaded nothing but the bench: starting Python anew
takes longer than most rules do.
"""

from __future__ import annotations

import itertools
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


class _Child:
    """A process of a job, which the process that forked it tells of."""

    def __init__(self) -> None:
        self.pid = 0
        self.code: int | None = None
        self.begun, self.ended = threading.Event(), threading.Event()


class _Forks:
    """The process that forks one for each job; there is one for all checks under way.

    It ends with the last of them, and at the latest with this process, which closes its input.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = 0
        self._server: subprocess.Popen[str] | None = None
        self._numbers = itertools.count()
        self._children: dict[int, _Child] = {}

    def enter(self) -> None:
        """Another check begins; a process is started with its first job."""
        with self._lock:
            self._users += 1

    def leave(self) -> None:
        """A check is over."""
        with self._lock:
            self._users -= 1
            server = self._server if self._users == 0 else None
            if server is not None:
                self._server = None
        if server is not None and server.stdin is not None:
            server.stdin.close()
            server.wait()

    def start(self, job: Job) -> _Child:
        """The process that does a job, once it has begun."""
        child = _Child()
        with self._lock:
            if self._server is None or self._server.poll() is not None:
                self._server = subprocess.Popen(
                    [sys.executable, "-m", "congelation.conformance.child_main"],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    text=True,
                    cwd=os.sep,
                    env=_environment(),
                    start_new_session=True,
                )
                threading.Thread(target=self._listen, args=[self._server], daemon=True).start()
            assert self._server.stdin is not None
            number = next(self._numbers)
            self._children[number] = child
            with suppress(BrokenPipeError):  # `_listen` ends the child
                self._server.stdin.write(f"{number} {job.saved()}\n")
                self._server.stdin.flush()
        child.begun.wait()
        return child

    def _listen(self, server: subprocess.Popen[str]) -> None:
        """Note which processes begin and end, until the server ends, and with it all of them."""
        assert server.stdout is not None
        with server.stdout as lines:
            for line in lines:
                what, number, value = line.split()
                child = self._children[int(number)]
                if what == "begun":
                    child.pid = int(value)
                else:
                    child.code = int(value)
                    del self._children[int(number)]
                    child.ended.set()
                child.begun.set()
        server.wait()
        with self._lock:
            for child in self._children.values() if self._server in (server, None) else ():
                child.code = -signal.SIGKILL
                child.begun.set()
                child.ended.set()


_FORKS = _Forks()


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

    def open(self) -> None:
        """A check begins."""
        _FORKS.enter()

    def close(self) -> None:
        """The check is over."""
        _FORKS.leave()

    def stop(self) -> None:
        """Kill whatever runs, and start nothing more."""
        with self._starting:
            self._stopped = True
            for group in tuple(self._running):
                _kill(group)

    def run(self, job: Job, factor: float = 1.0) -> Ended:
        """Let a process do a job, in its time."""
        limit = self._time_limit * factor
        with self._starting:
            if self._stopped:
                return Ended(None, "not done: the check was interrupted", "", None)
            child = _FORKS.start(job)
            self._running.add(child.pid)
        try:
            code, allowed = self._wait(child, job, limit)
        finally:
            # All processes of the group, since a rule or the FMU may have started others.
            _kill(child.pid)
            child.ended.wait()
            with self._starting:
                self._running.discard(child.pid)
        where = Tape.read(job.tape)
        if code is None:
            how = f"not done after {allowed:.3g} s (in {where or 'the rule'})"
        else:
            how = f"the process {ending(code)}" + (f" in {where}" if where else "")
        lines = job.words.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        left = json.loads(job.result.read_text(encoding="utf-8")) if job.result.exists() else None
        return Ended(code, how, lines[-1][-_LAST_WORDS:] if lines else "", left)

    def _wait(self, child: _Child, job: Job, limit: float) -> tuple[int | None, float]:
        """The exit code of a child, None if its time is up or that of a single call, and the time.

        A call may take a part of the usual limit, also in rules that may take longer in all.
        """
        of_a_call = max(self._time_limit * _CALL, min(self._time_limit, _SHORT))
        end = time.monotonic() + limit
        state, since = b"", time.monotonic()
        while (now := time.monotonic()) < end:
            if child.ended.wait(min(_POLL, end - now)):
                return child.code, limit
            found = Tape.state(job.tape)
            if found != state or not Tape.read(job.tape):
                state, since = found, time.monotonic()
            elif time.monotonic() - since > of_a_call:
                return None, of_a_call
        return None, limit


def _kill(group: int) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(group, signal.SIGKILL)


def _environment() -> dict[str, str]:
    """That of this process; the package is found."""
    root = str(Path(congelation.__file__).parents[1])
    paths = os.pathsep.join((root, *filter(None, [os.environ.get("PYTHONPATH")])))
    return {**os.environ, "PYTHONPATH": paths}
