"""A report as lines and a table for people, as JSON, and as JUnit XML for a CI server."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator

from rich.markup import escape
from rich.table import Table
from rich.text import Text

from congelation.conformance.finding import Finding, FmuReport, Report, Verdict
from congelation.conformance.rule import Level, Outcome

__all__ = ["to_json", "to_junit", "to_lines", "to_table", "words_of"]

_STYLES = {
    Outcome.PASS: "green",
    Outcome.FOUND: "bold red",
    Outcome.KNOWN: "yellow",
    Outcome.NOT_APPLICABLE: "dim",
    Outcome.NOT_EVALUATED: "dim",
}


def to_lines(fmu: FmuReport) -> Iterator[str]:
    """One line for each finding, one for all accepted ones, and the counts."""
    if not fmu.in_scope:
        return
    for finding in sorted(fmu.findings, key=lambda f: f.level.weight):
        if not finding.known:
            yield str(finding)
    known = [finding.rule for finding in fmu.findings if finding.known]
    if known:
        names = ", ".join(known)
        yield f"{fmu.path}: {len(known)} known, not counted (--table says why): {names}"
    reasons: dict[str, list[str]] = {}
    for verdict in fmu.verdicts:
        if verdict.outcome is Outcome.NOT_EVALUATED:
            reasons.setdefault(verdict.reason, []).append(verdict.rule.id)
    for reason, rules in reasons.items():
        what = rules[0] if len(rules) == 1 else f"{len(rules)} rules"
        yield f"{fmu.path}: {what} not evaluated: {reason}"
    yield f"{fmu.path}: {_counted(fmu)}"


def _counted(fmu: FmuReport) -> str:
    counts = [
        f"{sum(f.level is level and not f.known for f in fmu.findings)} {level.value}"
        for level in Level
    ]
    rest = (Outcome.PASS, Outcome.KNOWN, Outcome.NOT_APPLICABLE, Outcome.NOT_EVALUATED)
    return ", ".join((*counts, *(f"{fmu.count(outcome)} {outcome.value}" for outcome in rest)))


def words_of(verdict: Verdict) -> list[str]:
    """What there is to say of a verdict, line by line."""
    lines = [breach.what for breach in verdict.breaches]
    lines += [verdict.reason] if verdict.reason else []
    return [*lines, *(f"note: {n}" for n in verdict.notes), *(f"log: {m}" for m in verdict.log)]


def to_table(fmu: FmuReport) -> Table:
    """What became of every rule, with all breaches, notes and reasons."""
    table = Table(title=str(fmu.path), title_justify="left", show_lines=True)
    for column in ("rule", "section", "level", "outcome", "finding"):
        table.add_column(column, no_wrap=column == "rule")
    for verdict in fmu.verdicts:
        more = "\n".join(words_of(verdict))
        table.add_row(
            verdict.rule.id,
            verdict.rule.section,
            verdict.rule.level.value,
            Text(verdict.outcome.value, style=_STYLES[verdict.outcome]),
            escape(verdict.rule.sentence) + (f"\n[dim]{escape(more)}[/dim]" if more else ""),
        )
    return table


def _finding(finding: Finding, verdict: Verdict) -> dict[str, object]:
    return {
        "rule": finding.rule,
        "level": finding.level.value,
        "file": finding.file,
        "line": finding.line,
        "what": finding.what,
        "remedy": finding.remedy,
        "evidence": list(finding.evidence),
        "known": finding.known,
        "section": verdict.rule.section,
        "standard": verdict.rule.quote,
    }


def to_json(report: Report) -> str:
    """The report as JSON: for each FMU its scope, its findings, and what became of each rule."""
    fmus = []
    for fmu in report.fmus:
        broken = [v for v in fmu.verdicts if v.outcome in (Outcome.FOUND, Outcome.KNOWN)]
        fmus.append(
            {
                "fmu": str(fmu.path),
                "scope": fmu.scope,
                "counts": {outcome.value: fmu.count(outcome) for outcome in Outcome},
                "findings": [_finding(f, v) for f, v in zip(fmu.findings, broken, strict=True)],
                "rules": [
                    {
                        "rule": verdict.rule.id,
                        "kind": verdict.rule.kind,
                        "outcome": verdict.outcome.value,
                        "reason": verdict.reason,
                        "notes": list(verdict.notes),
                        "seconds": round(verdict.seconds, 3),
                    }
                    for verdict in fmu.verdicts
                ],
            }
        )
    counts = {
        level.value: sum(f.level is level and not f.known for f in report.findings)
        for level in Level
    }
    return json.dumps({"counts": counts, "fmus": fmus}, indent=2)


def to_junit(report: Report, fail_on: Level = Level.VIOLATION) -> str:
    """The report as JUnit XML: one suite for each FMU, one case for each rule.

    A finding of the level `fail_on` or a graver one is a failure; one of another level is in the
    output of its case. Accepted findings and rules that did not look are skipped.
    """
    root = ElementTree.Element("testsuites", name="congelation check")
    for fmu in report.fmus:
        suite = ElementTree.SubElement(root, "testsuite", name=fmu.path.name)
        failures = skipped = 0
        for verdict in fmu.verdicts:
            case = ElementTree.SubElement(
                suite,
                "testcase",
                classname=fmu.path.stem,
                name=f"{verdict.rule.id}: {verdict.rule.sentence}",
                time=f"{verdict.seconds:.3f}",
            )
            text = _printable("\n".join((*words_of(verdict), verdict.rule.page())))
            if verdict.outcome is Outcome.PASS:
                continue
            if verdict.outcome is not Outcome.FOUND:
                skipped += 1
                reason = _printable(f"{verdict.outcome.value}: {verdict.reason}")
                ElementTree.SubElement(case, "skipped", message=reason).text = text
            elif verdict.rule.level.weight <= fail_on.weight:
                failures += 1
                message = _printable(str(Finding.of(str(fmu.path), verdict)))
                kind = verdict.rule.level.value
                ElementTree.SubElement(case, "failure", message=message, type=kind).text = text
            else:
                ElementTree.SubElement(case, "system-out").text = text
        counts = {"tests": len(fmu.verdicts), "failures": failures, "errors": 0, "skipped": skipped}
        for name, count in counts.items():
            suite.set(name, str(count))
        suite.set("time", f"{sum(verdict.seconds for verdict in fmu.verdicts):.3f}")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True)


def _printable(text: str) -> str:
    """Without the characters that XML cannot hold."""
    return "".join(
        c
        if c in "\t\n" or 32 <= ord(c) < 0xD800 or 0xE000 <= ord(c) < 0xFFFE or ord(c) > 0xFFFF
        else "\N{REPLACEMENT CHARACTER}"
        for c in text
    )
