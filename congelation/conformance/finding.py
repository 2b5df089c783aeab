"""What became of rules: verdicts, the findings among them, and reports on FMUs."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from congelation.conformance.rule import Breach, DynamicRule, Level, Outcome, Rule
from congelation.conformance.rules import RULES
from congelation.errors import counted

__all__ = ["Finding", "FmuReport", "Report", "Verdict", "merged", "verdict_of"]

SHOWN = 8
"""Findings that the `repr` of a report names."""


@dataclass(frozen=True)
class Verdict:
    """What became of one rule for one FMU.

    Attributes
    ----------
    breaches : tuple of Breach
        Where the rule is broken.
    reason : str
        Why the rule does not apply or was not evaluated, or why its finding is accepted.
    notes : tuple of str
        Things worth knowing that are no breach.
    log : tuple of str
        The last messages that the FMU logged or printed.
    cause : str
        What failed, where several rules may meet the same failure.
    """

    rule: Rule
    outcome: Outcome
    breaches: tuple[Breach, ...] = ()
    reason: str = ""
    notes: tuple[str, ...] = ()
    log: tuple[str, ...] = ()
    cause: str = ""
    seconds: float = 0.0


def verdict_of(rule: Rule, report: Mapping[str, Any]) -> Verdict:
    """The verdict that a child left as JSON (`congelation.conformance.child_main`)."""
    return Verdict(
        rule,
        Outcome[report["outcome"]],
        tuple(Breach(*breach) for breach in report.get("breaches", ())),
        report["reason"],
        tuple(report.get("notes", ())),
        tuple(report.get("log", ())),
        report.get("cause", ""),
    )


@dataclass(frozen=True)
class Finding:
    """One broken rule in one FMU, as it is reported.

    Attributes
    ----------
    fmu : str
        The FMU, as given.
    file : str
        The file inside the FMU, "" for the FMU as a whole.
    line : int or None
        Line of that file, where known.
    what : str
        The breach; of several the first, and how many more there are.
    evidence : tuple of str
        All breaches, and the last messages of the FMU.
    known : str
        Why the finding is accepted, "" where it is not.
    """

    rule: str
    level: Level
    fmu: str
    file: str
    line: int | None
    what: str
    remedy: str
    evidence: tuple[str, ...] = ()
    known: str = ""

    @classmethod
    def of(cls, fmu: str, verdict: Verdict) -> Self:
        """The finding of a verdict whose rule is broken."""
        first, more = verdict.breaches[0], len(verdict.breaches) - 1
        return cls(
            rule=verdict.rule.id,
            level=verdict.rule.level,
            fmu=fmu,
            file=first.file,
            line=first.line,
            what=first.what + (f" (and {more} more)" if more else ""),
            remedy=verdict.rule.remedy,
            evidence=(
                *(breach.what for breach in verdict.breaches),
                *(f"the FMU's log: {line}" for line in verdict.log),
            ),
            known=verdict.reason if verdict.outcome is Outcome.KNOWN else "",
        )

    def __str__(self) -> str:
        place = "/".join(filter(None, (self.fmu, self.file)))
        place += f":{self.line}" if self.line else ""
        what = re.sub(r"\s+", " ", self.what).rstrip(".")
        return f"{place}: {self.rule} {self.level.value}: {what} - {self.remedy}"


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
        broken = (Outcome.FOUND, Outcome.KNOWN)
        return tuple(Finding.of(str(self.path), v) for v in self.verdicts if v.outcome in broken)

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

    def __repr__(self) -> str:
        """The counts, and the first findings: the verdicts on all rules would fill pages."""
        counts = Counter(v.outcome.value for fmu in self.fmus for v in fmu.verdicts)
        lines = [
            f"{counted(len(self.fmus), 'FMU')}: "
            + ", ".join(f"{n} {outcome}" for outcome, n in counts.items())
        ]
        lines += [f"  {finding}" for finding in self.findings[:SHOWN]]
        more = len(self.findings) - SHOWN
        return "\n".join([*lines, f"  and {more} more"] if more > 0 else lines)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The findings in all FMUs, the accepted ones among them."""
        return tuple(finding for fmu in self.fmus for finding in fmu.findings)

    def failures(self, level: Level = Level.VIOLATION) -> tuple[Finding, ...]:
        """The findings of a level and of the graver ones that are not accepted."""
        return tuple(f for f in self.findings if not f.known and f.level.weight <= level.weight)


def merged(verdicts: Sequence[Verdict]) -> tuple[Verdict, ...]:
    """One finding for each cause: of the rules that met the same failure, one keeps it.

    That is the rule to which the failing call belongs, or the gravest of them, or the first.
    """
    groups: dict[str, list[int]] = defaultdict(list)
    for place, verdict in enumerate(verdicts):
        if verdict.outcome is Outcome.FOUND and verdict.cause:
            groups[_key(verdict.cause)].append(place)
    kept = list(verdicts)
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
                kept[place] = replace(
                    verdicts[place], outcome=Outcome.NOT_EVALUATED, breaches=(), reason=reason
                )
    return tuple(kept)


def _key(cause: str) -> str:
    """What makes two causes one: the call and its status for calls that belong to a rule."""
    owned = {name for rule in RULES if isinstance(rule, DynamicRule) for name in rule.owns}
    found = re.match(r"(fmi2\w+)\b.* returned (fmi2\w+)$", cause)
    if found and {found[1], f"{found[1]} {found[2]}"} & owned:
        return f"{found[1]} {found[2]}"
    return cause
