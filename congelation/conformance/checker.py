"""One FMU and its rules: static rules here, each dynamic rule in a process of its own.

A dynamic rule may crash, hang or be killed by what it does to the FMU, and that is a finding like
any other; so it gets a process, a time limit, and a scratch directory that goes away. Before the
dynamic rules a survey finds out what the FMU can do at all (load, run, run twice), so that one
fault is one finding and the rules behind it are not evaluated.
"""

from __future__ import annotations

import json
import shutil
import threading
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from congelation.conformance.accepted import is_pythonfmu, limit_of
from congelation.conformance.binding import Tape
from congelation.conformance.child_processes import Children
from congelation.conformance.finding import Verdict, verdict_of
from congelation.conformance.host import ending
from congelation.conformance.job import Ability, Job, binary_path, platform_folder
from congelation.conformance.rule import (
    DEFAULT_TIME_LIMIT,
    Breach,
    DynamicRule,
    NotApplicable,
    Outcome,
    Rule,
    StaticRule,
    judge,
)
from congelation.conformance.subject import open_subject

__all__ = ["Checker"]


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
        self._children = Children(time_limit)
        self._temporary = TemporaryDirectory(
            prefix="congelation-check-", ignore_cleanup_errors=True
        )
        self._root = Path(self._temporary.name)
        self._subject = open_subject(path)
        self._surveying = threading.Lock()
        self._ability: Ability | None = None
        self.scope, self.in_scope, self._obstacle = self._find_scope(static)
        if self._obstacle:
            return
        try:
            for source, name in ((path, "fmu"), (self._companion, "companion")):
                if source.is_dir():
                    shutil.copytree(source, self._root / name)
                    continue
                with zipfile.ZipFile(source) as archive:
                    archive.extractall(self._root / name)
        except (OSError, zipfile.BadZipFile, RuntimeError, NotImplementedError) as error:
            self._obstacle = f"the archive cannot be unzipped ({error}); see FMI2-PACK"

    def __enter__(self) -> Checker:
        self._children.open()
        return self

    def __exit__(self, *raised: object) -> None:
        self._children.close()
        self._temporary.cleanup()

    def stop(self) -> None:
        """Kill whatever runs, and start nothing more."""
        self._children.stop()

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
            for key, name in (
                ("CoSimulation", "co-simulation"),
                ("ModelExchange", "model exchange"),
            )
            if key in description.identifiers
        ]
        what = f"FMI {version or '2.0'} {' and '.join(kinds) or 'without interface'}{unpacked}"
        why = ""
        if "CoSimulation" not in description.identifiers:
            why = "no FMU for co-simulation; model exchange is called in FMUs of both kinds alone"
        elif binary_path(Path(), description).as_posix() not in {
            name.replace("\\", "/") for name in self._subject.names
        }:
            why = f"no binary for this platform ({platform_folder()})"
        elif static:
            why = "dynamic rules were not asked for"
        if why:
            return f"{what}, {only}: {why}", True, why
        return f"{what}, static rules and dynamic rules on {platform_folder()}", True, ""

    def _looked(self, rule: Rule) -> Verdict:
        if not self.in_scope:
            return Verdict(rule, Outcome.NOT_APPLICABLE, reason=self.scope)
        if isinstance(rule, StaticRule):
            outcome, breaches, reason, _ = judge(rule, self._subject)
            return Verdict(rule, outcome, breaches, reason)
        if self._obstacle:
            return Verdict(rule, Outcome.NOT_EVALUATED, reason=self._obstacle)
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
        with self._job(able, task=task) as job:
            ended = self._children.run(job)
        if ended.report is not None:
            return str(ended.report.get("text", "")), str(ended.report.get("error", ""))
        return "", ended.how + (f": {ended.said}" if ended.said else "")

    @contextmanager
    def _job(
        self, able: Ability, *, rule: DynamicRule | None = None, task: str = ""
    ) -> Iterator[Job]:
        """A job with a scratch directory, which goes away."""
        name = task if rule is None else rule.id
        with TemporaryDirectory(
            dir=self._root, prefix=f"{name}-", ignore_cleanup_errors=True
        ) as scratch:
            yield Job(
                directory=str(self._root / "fmu"),
                companion=str(self._root / "companion"),
                scratch=scratch,
                rule="" if rule is None else rule.id,
                module="" if rule is None else rule.look.__module__,
                task=task,
                able=able,
            )

    def _in_child(self, rule: DynamicRule, able: Ability) -> Verdict:
        with self._job(able, rule=rule) as job:
            ended = self._children.run(job, rule.time_factor)
            where = Tape.read(job.tape)
        log = (ended.said,) if ended.said else ()
        if ended.code is None or ended.report is None:
            cause = ended.how if ended.code is not None else f"hang in {where}"
            return Verdict(rule, Outcome.FOUND, (Breach(ended.how),), log=log, cause=cause)
        verdict = verdict_of(rule, ended.report)
        if not (rule.ends_normally and ended.code != 0):
            return verdict
        found = (*verdict.breaches, Breach(f"the process {ending(ended.code)} at its end"))
        return replace(verdict, outcome=Outcome.FOUND, breaches=found, log=log)

    def _excused(self, verdict: Verdict) -> Verdict:
        """A finding that the FMU's wrapper alone causes becomes a known one."""
        if verdict.outcome is not Outcome.FOUND or not is_pythonfmu(self._root / "fmu"):
            return verdict
        limit = limit_of(verdict.rule.id, verdict.breaches[0].what)
        if limit is None:
            return verdict
        return replace(verdict, outcome=Outcome.KNOWN, reason=f"{limit.id}: {limit.sentence}")


def _loading(why: str) -> str:
    """The rule whose finding it is that the library cannot be loaded."""
    missing = "cannot open shared object file" in why
    return "FMI2-HOST-02" if missing else "FMI2-LIB-01"
