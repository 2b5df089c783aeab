"""Checking FMUs: static rules here, each dynamic rule in a process of its own.

A dynamic rule may crash, hang or be killed by what it does to the FMU, and that is a finding like
any other; so it gets a process, a time limit, and a scratch directory that goes away. Before the
dynamic rules a survey finds out what the FMU can do at all (load, run, run twice), so that one
fault is one finding and the rules behind it are not evaluated.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import zipfile
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType, TracebackType

import congelation
from congelation.conformance.bench import Ability, Job, binary_path, platform_folder
from congelation.conformance.binding import Tape
from congelation.conformance.host import ending
from congelation.conformance.known import Accepted, is_pythonfmu, limit_of, read_known
from congelation.conformance.rule import (
    BY_ID,
    CO_SIMULATION,
    DEFAULT_TIME_LIMIT,
    MODEL_EXCHANGE,
    Breach,
    DynamicRule,
    Finding,
    Level,
    NotApplicable,
    Outcome,
    Rule,
    StaticRule,
    Verdict,
    judge,
)
from congelation.conformance.rules import RULES
from congelation.conformance.subject import open_subject
from congelation.errors import InvalidInput, nearest

__all__ = ["Checker", "FmuReport", "Progress", "Report", "check", "select"]

Progress = Callable[[Path, Verdict], None]

# Characters of what a process wrote last.
_LAST_WORDS = 300
# Seconds between two looks at a child.
_POLL = 0.2
# The part of a rule's time after which one call hangs, but no less than so many seconds.
_CALL, _SHORT = 1 / 3, 5.0


@dataclass(frozen=True)
class FmuReport:
    """What the rules found in one FMU, in the order of the rules.

    Attributes
    ----------
    scope : str
        What was checked and what was not, in one line.
    in_scope : bool
        False if nothing could be checked, because the FMU is of another version of FMI.
    """

    path: Path
    scope: str
    in_scope: bool
    verdicts: tuple[Verdict, ...]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The broken rules, the accepted ones among them."""
        told = (Outcome.FOUND, Outcome.KNOWN)
        return tuple(Finding.of(str(self.path), v) for v in self.verdicts if v.outcome in told)

    def count(self, outcome: Outcome) -> int:
        """How many rules ended with an outcome."""
        return sum(verdict.outcome is outcome for verdict in self.verdicts)


@dataclass(frozen=True)
class Report:
    """What the rules found in all FMUs.

    Attributes
    ----------
    unused : tuple of str
        Entries of the file of known findings that nothing was found for.
    """

    fmus: tuple[FmuReport, ...]
    unused: tuple[str, ...] = ()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The findings in all FMUs, the accepted ones among them."""
        return tuple(finding for fmu in self.fmus for finding in fmu.findings)

    def failures(self, level: Level = Level.VIOLATION) -> tuple[Finding, ...]:
        """The findings of a level and of the graver ones that are not accepted."""
        return tuple(f for f in self.findings if not f.known and f.level.weight <= level.weight)


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
        The FMU, packed or as a directory.
    companion : Path, optional
        Another FMU, for the rules that load two; the same one again if not given.
    time_limit : float
        Seconds that a dynamic rule may take (times its own factor).
    static : bool
        Leave the dynamic rules out.
    """

    def __init__(
        self,
        path: Path,
        companion: Path | None = None,
        time_limit: float = DEFAULT_TIME_LIMIT,
        *,
        static: bool = False,
    ) -> None:
        self.path = path
        self._companion = companion or path
        self._time_limit = time_limit
        self._running: set[int] = set()
        self._stopped = False
        self._temporary = TemporaryDirectory(
            prefix="congelation-check-", ignore_cleanup_errors=True
        )
        self._root = Path(self._temporary.name)
        self._subject = open_subject(path)
        self._surveying = threading.Lock()
        self._ability: Ability | None = None
        self.scope, self.in_scope, self._obstacle = self._find_scope(static)
        if not self._obstacle:
            self._unzip()

    def __enter__(self) -> Checker:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._temporary.cleanup()

    def stop(self) -> None:
        """Kill whatever runs, and start nothing more."""
        self._stopped = True
        for group in tuple(self._running):
            with suppress(ProcessLookupError):
                os.killpg(group, signal.SIGKILL)

    def check(self, rule: Rule) -> Verdict:
        """Let one rule look at the FMU."""
        begin = time.monotonic()
        verdict = self._looked(rule)
        return replace(self._excused(verdict), seconds=time.monotonic() - begin)

    def _find_scope(self, static: bool) -> tuple[str, bool, str]:
        """The line that says what is checked, whether anything is, and why no dynamic rules."""
        unpacked = " (unpacked)" if self._subject.unpacked else ""
        only = "static rules only"
        try:
            description = self._subject.description
        except NotApplicable as reason:
            return f"{only}: {reason}", True, str(reason)
        version = description.fmi_version
        if version and not version.startswith("2."):
            line = f"FMI {version}: not checked, the rules are those of FMI 2.0"
            return line, False, line
        kinds = [
            name
            for key, name in (("CoSimulation", CO_SIMULATION), ("ModelExchange", MODEL_EXCHANGE))
            if key in description.identifiers
        ]
        what = f"FMI {version or '2.0'} {' and '.join(kinds) or 'without interface'}{unpacked}"
        why = ""
        if CO_SIMULATION not in kinds:
            why = "no FMU for co-simulation; there are no dynamic rules for model exchange"
        elif not self._has_binary():
            why = f"no binary for this platform ({platform_folder()})"
        elif static:
            why = "as asked for"
        if why:
            return f"{what}, {only}: {why}", True, why
        more = "; of model exchange the static rules alone" if len(kinds) > 1 else ""
        return f"{what}, static rules and dynamic rules on {platform_folder()}{more}", True, ""

    def _has_binary(self) -> bool:
        wanted = binary_path(Path(), self._subject.description).as_posix()
        return wanted in {name.replace("\\", "/") for name in self._subject.names}

    def _unzip(self) -> None:
        """Unpack the FMU and its companion, or note why that fails."""
        try:
            for path, name in ((self.path, "fmu"), (self._companion, "companion")):
                if path.is_dir():
                    shutil.copytree(path, self._root / name)
                    continue
                with zipfile.ZipFile(path) as archive:
                    archive.extractall(self._root / name)
        except (OSError, zipfile.BadZipFile, RuntimeError, NotImplementedError) as error:
            self._obstacle = f"the archive cannot be unzipped ({error}); see FMI2-PACK"

    def _looked(self, rule: Rule) -> Verdict:
        if not self.in_scope:
            return Verdict(rule, Outcome.NOT_APPLICABLE, reason=self.scope)
        if isinstance(rule, StaticRule):
            outcome, breaches, reason, _ = judge(rule, self._subject)
            return Verdict(rule, outcome, breaches, reason)
        if self._obstacle:
            return Verdict(rule, Outcome.NOT_APPLICABLE, reason=self._obstacle)
        if not isinstance(rule, DynamicRule):
            raise TypeError(f"{rule.id} is neither static nor dynamic")
        with self._surveying:
            if self._ability is None:
                self._ability = self._survey()
        able = self._ability
        if rule.needs and able.loads and rule.id != _loading(able.loads):
            reason = f"the library cannot be loaded, see {_loading(able.loads)}"
            return Verdict(rule, Outcome.NOT_EVALUATED, reason=reason)
        if rule.needs == "run" and able.runs:
            return Verdict(rule, Outcome.NOT_EVALUATED, reason="a plain run fails, see FMI2-LIB-03")
        return self._in_child(rule, able)

    def _survey(self) -> Ability:
        """Find out what the FMU can do.

        In one process if all goes well; if not, each question in a process of its own.
        """
        able, reference = Ability(), self._root / "reference.json"
        text, failed = self._task("survey", able)
        if not failed:
            found = json.loads(text)
            reference.write_text(found["run"], encoding="utf-8")
            return Ability(repeats=not found["difference"], reference=str(reference))
        _, failed = self._task("load", able)
        if failed:
            return replace(able, loads=failed)
        still = replace(able, moves=False)
        text, failed = self._task("alone", still)
        if failed:
            return replace(still, runs=failed)
        moving, failed = self._task("alone", able)
        if failed:
            able = still
        reference.write_text(text if failed else moving, encoding="utf-8")
        difference, again = self._task("again", able)
        _, beside = self._task("beside", able)
        flagged = self._subject.description.flag("canBeInstantiatedOnlyOncePerProcess")
        single = "canBeInstantiatedOnlyOncePerProcess is true, and a second instance fails"
        why = "a second instance in a process fails, see FMI2-INST-04"
        return replace(
            able,
            again="" if not again else single if flagged else why,
            beside="a second instance beside the first fails, see FMI2-FLAG-07" if beside else "",
            repeats=not difference,
            reference=str(reference),
        )

    def _task(self, task: str, able: Ability) -> tuple[str, str]:
        """The text that a task leaves, and why it failed ("" if it did not)."""
        with self._scratch(task) as scratch:
            job = self._job(scratch, able, task=task)
            code, said = self._spawn(job, self._time_limit)
            if job.result.exists():
                report = json.loads(job.result.read_text(encoding="utf-8"))
                return report.get("text", ""), report.get("error", "")
            return "", _ended(code, job, self._time_limit) + (f": {said}" if said else "")

    def _job(self, scratch: Path, able: Ability, *, rule: str = "", task: str = "") -> Job:
        return Job(
            directory=str(self._root / "fmu"),
            companion=str(self._root / "companion"),
            scratch=str(scratch),
            rule=rule,
            task=task,
            able=able,
        )

    @contextmanager
    def _scratch(self, name: str) -> Iterator[Path]:
        with TemporaryDirectory(
            dir=self._root, prefix=f"{name}-", ignore_cleanup_errors=True
        ) as scratch:
            yield Path(scratch)

    def _in_child(self, rule: DynamicRule, able: Ability) -> Verdict:
        with self._scratch(rule.id) as scratch:
            job = self._job(scratch, able, rule=rule.id)
            limit = self._time_limit * rule.time_factor
            code, said = self._spawn(job, limit)
            log = (said,) if said else ()
            if code is not None and job.result.exists():
                report = json.loads(job.result.read_text(encoding="utf-8"))
                verdict = Verdict(
                    rule,
                    Outcome[report["outcome"]],
                    tuple(Breach(*breach) for breach in report.get("breaches", ())),
                    report["reason"],
                    tuple(report.get("notes", ())),
                    tuple(report.get("log", ())),
                    report.get("cause", ""),
                )
                if not (rule.ends_normally and code != 0):
                    return verdict
                line = Breach(f"the process {ending(code)} at its end")
                found = (*verdict.breaches, line)
                return replace(verdict, outcome=Outcome.FOUND, breaches=found, log=log)
            what = _ended(code, job, limit)
            cause = what if code is not None else f"hang in {Tape.read(job.tape)}"
            return Verdict(rule, Outcome.FOUND, (Breach(what),), log=log, cause=cause)

    def _spawn(self, job: Job, limit: float) -> tuple[int | None, str]:
        """Run a child; its exit code, None if it had to be killed, and the end of its output."""
        if self._stopped:
            return None, ""
        root = str(Path(congelation.__file__).parents[1])
        paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
        words = Path(job.scratch) / "stderr"
        # A file and no pipe: a process that the FMU starts and leaves may hold a pipe open.
        with words.open("wb") as stderr:
            process = subprocess.Popen(
                [sys.executable, "-m", "congelation.conformance.child"],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=stderr,
                cwd=job.scratch,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
                start_new_session=True,
            )
        self._running.add(process.pid)
        assert process.stdin is not None
        if self._stopped:
            self.stop()
        code: int | None = None
        try:
            with suppress(BrokenPipeError):
                process.stdin.write(json.dumps(asdict(job)).encode())
                process.stdin.close()
            code = _waited(process, job, limit, self._time_limit)
        finally:
            # All processes of the group, since a rule or the FMU may have started others.
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            self._running.discard(process.pid)
        lines = words.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return code, lines[-1][-_LAST_WORDS:] if lines else ""

    def _excused(self, verdict: Verdict) -> Verdict:
        """A finding that the FMU's wrapper alone causes becomes a known one."""
        if verdict.outcome is not Outcome.FOUND or not is_pythonfmu(self._root / "fmu"):
            return verdict
        limit = limit_of(verdict.rule.id, verdict.breaches[0].what)
        if limit is None:
            return verdict
        return replace(verdict, outcome=Outcome.KNOWN, reason=f"{limit.id}: {limit.sentence}")


def _waited(process: subprocess.Popen[bytes], job: Job, limit: float, usual: float) -> int | None:
    """The exit code of a child; None if its time is up, or that of a single call.

    The latter is a part of the usual limit, also for rules that may take longer in all.
    """
    end = time.monotonic() + limit
    state, since = b"", time.monotonic()
    while (now := time.monotonic()) < end:
        with suppress(subprocess.TimeoutExpired):
            return process.wait(min(_POLL, end - now))
        found = Tape.state(job.tape)
        if found != state or not Tape.read(job.tape):
            state, since = found, time.monotonic()
        elif time.monotonic() - since > max(usual * _CALL, min(usual, _SHORT)):
            return None
    return None


def _loading(why: str) -> str:
    """The rule whose finding it is that the library cannot be loaded."""
    missing = "cannot open shared object file" in why
    return "FMI2-HOST-02" if missing else "FMI2-LIB-01"


def _ended(code: int | None, job: Job, limit: float) -> str:
    """How a child ended that left no result, and in which call."""
    where = Tape.read(job.tape)
    if code is None:
        return f"not done after {limit:g} s (in {where or 'the rule'})"
    return f"the process {ending(code)}" + (f" in {where}" if where else "")


def _merged(verdicts: Sequence[Verdict]) -> tuple[Verdict, ...]:
    """One finding for each cause: of the rules that met the same failure, one keeps it.

    That is the rule to which the failing call belongs, or the gravest of them, or the first.
    """
    groups: dict[str, list[int]] = defaultdict(list)
    for place, verdict in enumerate(verdicts):
        if verdict.outcome is Outcome.FOUND and verdict.cause:
            groups[_key(verdict.cause)].append(place)
    merged = list(verdicts)
    for key, places in groups.items():

        def owner(place: int, key: str = key) -> bool:
            rule = verdicts[place].rule
            return isinstance(rule, DynamicRule) and any(name in key for name in rule.owns)

        found = [p for p, v in enumerate(verdicts) if v.outcome is Outcome.FOUND and owner(p)]
        keeper = min(
            {*places, *found}, key=lambda p: (p not in found, verdicts[p].rule.level.weight, p)
        )
        for place in places:
            if place != keeper:
                reason = f"{verdicts[place].breaches[0].what}, see {verdicts[keeper].rule.id}"
                merged[place] = replace(
                    verdicts[place], outcome=Outcome.NOT_EVALUATED, breaches=(), reason=reason
                )
    return tuple(merged)


_OWNED = frozenset(name for rule in RULES if isinstance(rule, DynamicRule) for name in rule.owns)


def _key(cause: str) -> str:
    """What makes two causes one: the call and its status for calls that belong to a rule."""
    found = re.match(r"(fmi2\w+)\b.* returned (fmi2\w+)$", cause)
    if found and {found[1], f"{found[1]} {found[2]}"} & _OWNED:
        return f"{found[1]} {found[2]}"
    return cause


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """Let SIGTERM raise KeyboardInterrupt, as Ctrl-C does (in the main thread, where it can)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def check(
    paths: Sequence[Path | str],
    *,
    rules: Iterable[str] = (),
    static: bool = False,
    known: Path | str | None = None,
    jobs: int | None = None,
    time_limit: float = DEFAULT_TIME_LIMIT,
    progress: Progress | None = None,
) -> Report:
    """Check FMUs against the rules of FMI 2.0.

    Parameters
    ----------
    paths : sequence of Path or str
        The FMUs, packed or as directories; each is also loaded next to the one after it.
    rules : iterable of str, optional
        Ids of rules or their beginnings ("FMI2-STATE"); all rules unless given.
    static : bool
        Only the rules that look at the archive and its XML.
    known : Path or str, optional
        A TOML file of accepted findings (`congelation.conformance.known.read_known`).
    jobs : int, optional
        How many rules to run at the same time; as many as there are processors unless given.
    time_limit : float
        Seconds that a dynamic rule may take (times its own factor).
    progress : callable, optional
        Called with the path and the verdict of each rule, as they come.

    Returns
    -------
    report : Report
        For each FMU its scope, its findings, and what became of each rule.

    Raises
    ------
    InvalidInput
        A path does not exist, a rule is not known, or the file of known findings is wrong.

    Examples
    --------
    >>> cg.check(["fmus/ScalarPlant.fmu"], static=True).failures()
    ()
    """
    chosen = select(rules) or RULES
    files = [Path(path) for path in paths]
    for path in files:
        if not path.exists():
            raise InvalidInput(f"there is no FMU at '{path}'")
    accepted = read_known(Path(known), BY_ID) if known is not None else ()
    used: set[Accepted] = set()
    reports = []
    with _terminated_as_interrupted(), ThreadPoolExecutor(jobs or os.cpu_count() or 1) as pool:
        for number, path in enumerate(files):
            companion = files[(number + 1) % len(files)]
            with Checker(path, companion, time_limit, static=static) as checker:

                def look(rule: Rule, checker: Checker = checker) -> Verdict:
                    verdict = checker.check(rule)
                    if progress is not None:
                        progress(checker.path, verdict)
                    return verdict

                try:
                    verdicts = _merged(tuple(pool.map(look, chosen)))
                except BaseException:
                    checker.stop()
                    pool.shutdown(wait=True, cancel_futures=True)
                    raise
            told = []
            for verdict in verdicts:
                entry = next((a for a in accepted if a.covers(verdict.rule.id, path)), None)
                if entry is not None and verdict.outcome is Outcome.FOUND:
                    used.add(entry)
                    verdict = replace(verdict, outcome=Outcome.KNOWN, reason=entry.reason)
                told.append(verdict)
            reports.append(FmuReport(path, checker.scope, checker.in_scope, tuple(told)))
    unused = tuple(f"{a.rule} in {a.fmu}" for a in accepted if a not in used)
    return Report(tuple(reports), unused)
