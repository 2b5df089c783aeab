"""Checking FMUs against the rules: which rules, which FMUs, in which order, and until when."""

from __future__ import annotations

import math
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType

from congelation.arguments import checked
from congelation.conformance.accepted import Accepted, read_known
from congelation.conformance.checker import Checker
from congelation.conformance.finding import FmuReport, Report, Verdict, merged
from congelation.conformance.rule import BY_ID, DEFAULT_TIME_LIMIT, Outcome, Rule, StaticRule
from congelation.conformance.rules import RULES
from congelation.conformance.subject import DESCRIPTION
from congelation.errors import InvalidInput, nearest, require_count
from congelation.fmi.unpack import require_no_other_kind

__all__ = ["check", "select"]


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


Opened = Callable[[Path, str], None]
Progress = Callable[[Path, Verdict], None]
Done = Callable[[FmuReport], None]


@contextmanager
def _ended_as_interrupted() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise KeyboardInterrupt, as Ctrl-C does.

    Signals reach the main thread alone; in another one nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    # Windows has no SIGHUP.
    numbers = [s for s in signal.Signals if s.name in ("SIGTERM", "SIGHUP")]
    before = {number: signal.signal(number, interrupt) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@checked
def check(
    paths: Sequence[Path | str],
    *,
    rules: Iterable[str] = (),
    static: bool = False,
    known: Path | str | None = None,
    jobs: int | None = None,
    time_limit: float = DEFAULT_TIME_LIMIT,
    opened: Opened | None = None,
    progress: Progress | None = None,
    done: Done | None = None,
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
        A TOML file of accepted findings, ``[[known]]`` (docs/conformance.md).
    jobs : int, optional
        How many rules to run at the same time; as many as there are processors unless given.
    time_limit : float
        Seconds that a dynamic rule may take (times its own factor).
    opened : callable, optional
        Called with the path and the scope of an FMU before its rules run.
    progress : callable, optional
        Called with the path and the verdict of each rule, as they come.
    done : callable, optional
        Called with the report on each FMU, as they come.

    Returns
    -------
    report : Report
        For each FMU its scope, its findings, and what became of each rule.

    Raises
    ------
    InvalidInput
        A path does not exist or is no FMU, a rule is not known, or the file of known findings is
        wrong.

    Examples
    --------
    >>> cg.check(["fmus/ScalarPlant.fmu"], static=True).failures()
    ()
    """
    if not paths:
        raise InvalidInput("paths is empty; give the FMUs to check")
    if jobs is not None:
        require_count(jobs, "jobs")
    if not 0.0 < time_limit < math.inf:
        raise InvalidInput(f"time_limit = {time_limit} is not valid; give a positive number of s")
    chosen = select(rules) or RULES
    if static and not any(isinstance(rule, StaticRule) for rule in chosen):
        raise InvalidInput(f"{chosen[0].id} runs the FMU: leave out 'static' or give other rules")
    files = _readable(paths)
    accepted = read_known(Path(known), BY_ID) if known is not None else ()
    used: set[Accepted] = set()
    reports = []
    with _ended_as_interrupted(), ThreadPoolExecutor(jobs or os.cpu_count() or 1) as pool:
        for number, path in enumerate(files):
            companion = files[(number + 1) % len(files)]
            with Checker(path, companion, time_limit, static=static) as checker:
                if opened is not None:
                    opened(path, checker.scope)
                verdicts = _verdicts(checker, chosen, pool, progress)
            # Findings that the user accepts become known ones.
            for place, verdict in enumerate(verdicts):
                entry = next((a for a in accepted if a.covers(verdict.rule.id, path)), None)
                if entry is not None and verdict.outcome is Outcome.FOUND:
                    used.add(entry)
                    verdicts[place] = replace(verdict, outcome=Outcome.KNOWN, reason=entry.reason)
            reports.append(FmuReport(path, checker.scope, checker.in_scope, tuple(verdicts)))
            if done is not None:
                done(reports[-1])
    unused = tuple(f"{a.rule} in {a.fmu}" for a in accepted if a not in used)
    return Report(tuple(reports), unused)


def _readable(paths: Sequence[Path | str]) -> list[Path]:
    """The paths, after checking that each is an FMU, packed or as a directory."""
    files = [Path(path) for path in paths]
    for path in files:
        if not path.exists():
            raise InvalidInput(f"there is no FMU at '{path}'")
        if path.is_dir() and not (path / DESCRIPTION).is_file():
            raise InvalidInput(f"the folder '{path}' is no unpacked FMU: it has no {DESCRIPTION}")
        if path.is_file():
            require_no_other_kind(path)
    return files


def _verdicts(
    checker: Checker, rules: Sequence[Rule], pool: ThreadPoolExecutor, progress: Progress | None
) -> list[Verdict]:
    """What became of each rule for one FMU; an interruption ends the processes under way."""

    def look(rule: Rule) -> Verdict:
        verdict = checker.check(rule)
        if progress is not None:
            progress(checker.path, verdict)
        return verdict

    try:
        return list(merged(tuple(pool.map(look, rules))))
    except BaseException:
        checker.stop()
        pool.shutdown(wait=True, cancel_futures=True)
        raise
