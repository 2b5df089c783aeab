"""Checking FMUs: static rules here, each dynamic rule in a process of its own.

A dynamic rule may crash, hang or be killed by what it does to the FMU, and that is a finding
like any other; so it gets a process, a time limit, and a scratch directory that goes away.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType

import congelation
from congelation.conformance.bench import Job
from congelation.conformance.binding import Tape
from congelation.conformance.host import ending
from congelation.conformance.limits import is_pythonfmu, limit_of
from congelation.conformance.rule import (
    DEFAULT_TIME_LIMIT,
    Finding,
    Kind,
    NotApplicable,
    Outcome,
    Rule,
    judge,
)
from congelation.conformance.rules import BY_ID, RULES
from congelation.conformance.subject import open_subject
from congelation.errors import InvalidInput, nearest

__all__ = ["Checker", "FmuReport", "Progress", "Report", "run", "select"]

Progress = Callable[[Path, Finding], None]


@dataclass(frozen=True)
class FmuReport:
    """What the rules found in one FMU, in the order of the rules."""

    path: Path
    findings: tuple[Finding, ...]

    def count(self, outcome: Outcome) -> int:
        """How many rules ended with an outcome."""
        return sum(finding.outcome is outcome for finding in self.findings)


@dataclass(frozen=True)
class Report:
    """What the rules found in all FMUs."""

    fmus: tuple[FmuReport, ...]

    @property
    def violations(self) -> int:
        """How many violations there are in all."""
        return sum(fmu.count(Outcome.VIOLATION) for fmu in self.fmus)


def select(names: Iterable[str]) -> tuple[Rule, ...]:
    """The rules whose ids are given, or begin with what is given (such as "FMI2-STATE").

    Raises
    ------
    InvalidInput
        A name fits no rule.
    """
    chosen: set[str] = set()
    for name in names:
        found = {rule for rule in BY_ID if rule == name or rule.startswith(f"{name}-")}
        if not found:
            raise InvalidInput(f"no rule is named '{name}': {nearest(name, BY_ID)}")
        chosen |= found
    return tuple(rule for rule in RULES if rule.id in chosen)


class Checker:
    """One FMU, opened and unzipped for as long as it is checked; a context manager.

    Parameters
    ----------
    path : Path
        The FMU.
    companion : Path, optional
        Another FMU, for the rules that load two; the same one again if not given.
    time_limit : float
        Seconds that a dynamic rule may take (times its own patience).
    """

    def __init__(
        self, path: Path, companion: Path | None = None, time_limit: float = DEFAULT_TIME_LIMIT
    ) -> None:
        self.path = path
        self._companion = companion or path
        self._time_limit = time_limit
        self._temporary = TemporaryDirectory(prefix="congelation-check-")
        self._root = Path(self._temporary.name)
        self._subject = open_subject(path)
        self._obstacle = self._unzip()

    def __enter__(self) -> Checker:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._temporary.cleanup()

    def check(self, rule: Rule) -> Finding:
        """Let one rule look at the FMU."""
        begin = time.monotonic()
        if rule.kind is Kind.STATIC:
            finding = Finding(rule, *judge(rule, self._subject))
        elif self._obstacle:
            finding = Finding(rule, Outcome.NOT_APPLICABLE, (self._obstacle,))
        else:
            finding = self._in_child(rule)
        return replace(self._excused(finding), seconds=time.monotonic() - begin)

    def _unzip(self) -> str:
        """Unzip the FMU and its companion; the reason why that fails, "" if it does not."""
        try:
            _ = self._subject.description
            for path, name in ((self.path, "fmu"), (self._companion, "companion")):
                with zipfile.ZipFile(path) as archive:
                    archive.extractall(self._root / name)
        except NotApplicable as reason:
            return str(reason)
        except (OSError, zipfile.BadZipFile, RuntimeError, NotImplementedError) as error:
            return f"the archive cannot be unzipped ({error}); see FMI2-PACK"
        return ""

    def _in_child(self, rule: Rule) -> Finding:
        with TemporaryDirectory(dir=self._root, prefix=f"{rule.id}-") as scratch:
            job = Job(
                directory=str(self._root / "fmu"),
                companion=str(self._root / "companion"),
                scratch=scratch,
                rule=rule.id,
            )
            limit = self._time_limit * rule.patience
            code, said = _spawn(job, limit)
            if code is None:
                where = Tape.read(job.tape) or "the rule"
                line = f"not done after {limit:g} s (in {where})"
                return Finding(rule, Outcome.VIOLATION, (line,))
            if job.result.exists():
                report = json.loads(job.result.read_text(encoding="utf-8"))
                lines, notes = tuple(report["lines"]), tuple(report["notes"])
                if not (rule.ends_normally and code != 0):
                    return Finding(rule, Outcome[report["outcome"]], lines, notes)
                line = f"the process {ending(code)} at its end{_tail(said)}"
                return Finding(rule, Outcome.VIOLATION, (*lines, line), notes)
            where = Tape.read(job.tape)
            line = f"the process {ending(code)}{f' in {where}' if where else ''}{_tail(said)}"
            return Finding(rule, Outcome.VIOLATION, (line,))

    def _excused(self, finding: Finding) -> Finding:
        """A violation that the FMU's wrapper alone is to blame for becomes a known limit."""
        limit = limit_of(finding.rule.id)
        if (
            finding.outcome is not Outcome.VIOLATION
            or limit is None
            or not is_pythonfmu(self._root / "fmu")
        ):
            return finding
        return replace(finding, outcome=Outcome.KNOWN_LIMIT, limit=limit.id)


def _tail(said: str) -> str:
    """The end of what a process wrote to standard error."""
    last = said.strip().splitlines()[-1:]
    return f": {last[0][-300:]}" if last else ""


def _spawn(job: Job, limit: float) -> tuple[int | None, str]:
    """Run a child to its end; its exit code, None if it had to be killed, and its last words."""
    root = str(Path(congelation.__file__).parents[1])
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    process = subprocess.Popen(
        [sys.executable, "-m", "congelation.conformance.child"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        cwd=job.scratch,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        text=True,
        errors="replace",
        start_new_session=True,
    )
    try:
        _, said = process.communicate(json.dumps(asdict(job)), timeout=limit)
    except subprocess.TimeoutExpired:
        # All its processes, since a rule may have started a host of its own.
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return None, ""
    return process.returncode, said


def run(
    paths: Sequence[Path],
    *,
    rules: Sequence[Rule] = RULES,
    jobs: int | None = None,
    time_limit: float = DEFAULT_TIME_LIMIT,
    progress: Progress | None = None,
) -> Report:
    """Check FMUs.

    Parameters
    ----------
    paths : sequence of Path
        The FMUs; each is also loaded next to the one after it.
    rules : sequence of Rule
        Which rules; all of them unless given.
    jobs : int, optional
        How many rules to run at the same time; as many as there are processors unless given.
    time_limit : float
        Seconds that a dynamic rule may take (times its own patience).
    progress : callable, optional
        Called with the path and each finding, as they come.

    Raises
    ------
    InvalidInput
        A path is no file.
    """
    for path in paths:
        if not path.is_file():
            raise InvalidInput(f"there is no FMU at '{path}'")
    workers = jobs or os.cpu_count() or 1
    reports = []
    with ThreadPoolExecutor(workers) as pool:
        for number, path in enumerate(paths):
            companion = paths[(number + 1) % len(paths)]
            with Checker(path, companion, time_limit) as checker:

                def look(rule: Rule, checker: Checker = checker) -> Finding:
                    finding = checker.check(rule)
                    if progress is not None:
                        progress(checker.path, finding)
                    return finding

                reports.append(FmuReport(path, tuple(pool.map(look, rules))))
    return Report(tuple(reports))
