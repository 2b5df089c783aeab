"""A report as a table for people, as JSON, and as JUnit XML for a CI server."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from congelation.conformance.limits import LIMITS
from congelation.conformance.rule import Finding, Outcome
from congelation.conformance.runner import FmuReport, Report

__all__ = ["print_report", "summary", "to_json", "to_junit", "to_table"]

_STYLES = {
    Outcome.PASS: "green",
    Outcome.VIOLATION: "bold red",
    Outcome.NOT_APPLICABLE: "dim",
    Outcome.KNOWN_LIMIT: "yellow",
}
_SENTENCES = {limit.id: limit.sentence for limit in LIMITS}
# More breaches of one rule say nothing new to a reader; JSON and JUnit hold all of them.
_SHOWN = 4


def summary(fmu: FmuReport) -> str:
    """The outcomes of one FMU, counted."""
    return ", ".join(f"{fmu.count(outcome)} {outcome.value}" for outcome in Outcome)


def _told(finding: Finding) -> str:
    """What a table says of a finding, below the rule's sentence."""
    lines = list(finding.lines[:_SHOWN])
    if len(finding.lines) > _SHOWN:
        lines.append(f"... and {len(finding.lines) - _SHOWN} more")
    if finding.limit:
        lines.append(f"{finding.limit}: {_SENTENCES[finding.limit]}")
    lines.extend(f"note: {note}" for note in finding.notes)
    return "\n".join(lines)


def to_table(fmu: FmuReport, *, everything: bool = False) -> Table:
    """One FMU's findings; without `everything`, those that passed or do not apply are left out."""
    table = Table(title=str(fmu.path), title_justify="left", show_lines=True)
    for column in ("rule", "section", "outcome", "finding"):
        table.add_column(column, no_wrap=column == "rule")
    quiet = (Outcome.PASS, Outcome.NOT_APPLICABLE)
    for finding in fmu.findings:
        if finding.outcome in quiet and not everything:
            continue
        told = _told(finding)
        table.add_row(
            finding.rule.id,
            finding.rule.section,
            Text(finding.outcome.value, style=_STYLES[finding.outcome]),
            escape(finding.rule.sentence) + (f"\n[dim]{escape(told)}[/dim]" if told else ""),
        )
    return table


def print_report(report: Report, console: Console, *, everything: bool = False) -> None:
    """Print a table for each FMU, as far as there is something to show, and its outcomes."""
    for fmu in report.fmus:
        table = to_table(fmu, everything=everything)
        if table.row_count:
            console.print(table)
        console.print(Text(f"{fmu.path.name}: {summary(fmu)}"), soft_wrap=True)


def to_json(report: Report) -> str:
    """The report as JSON: one object for each FMU, one for each finding in it."""
    fmus = [
        {
            "fmu": str(fmu.path),
            "counts": {outcome.value: fmu.count(outcome) for outcome in Outcome},
            "findings": [
                {
                    "rule": finding.rule.id,
                    "section": finding.rule.section,
                    "sentence": finding.rule.sentence,
                    "kind": finding.rule.kind.value,
                    "outcome": finding.outcome.value,
                    "lines": list(finding.lines),
                    "notes": list(finding.notes),
                    "limit": finding.limit,
                    "seconds": round(finding.seconds, 3),
                }
                for finding in fmu.findings
            ],
        }
        for fmu in report.fmus
    ]
    return json.dumps({"violations": report.violations, "fmus": fmus}, indent=2)


def to_junit(report: Report) -> str:
    """The report as JUnit XML: one suite for each FMU, one case for each rule.

    A violation is a failure; a rule that does not apply, and a known limit, are skipped.
    """
    root = ElementTree.Element("testsuites", name="congelation check")
    for fmu in report.fmus:
        skipped = fmu.count(Outcome.NOT_APPLICABLE) + fmu.count(Outcome.KNOWN_LIMIT)
        suite = ElementTree.SubElement(
            root,
            "testsuite",
            name=fmu.path.name,
            tests=str(len(fmu.findings)),
            failures=str(fmu.count(Outcome.VIOLATION)),
            errors="0",
            skipped=str(skipped),
            time=f"{sum(finding.seconds for finding in fmu.findings):.3f}",
        )
        for finding in fmu.findings:
            _case(suite, fmu, finding)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True)


def _case(suite: ElementTree.Element, fmu: FmuReport, finding: Finding) -> None:
    case = ElementTree.SubElement(
        suite,
        "testcase",
        classname=fmu.path.stem,
        name=f"{finding.rule.id}: {finding.rule.sentence}",
        time=f"{finding.seconds:.3f}",
    )
    text = _printable("\n".join((*finding.lines, f"FMI 2.0.5, section {finding.rule.section}")))
    if finding.outcome is Outcome.VIOLATION:
        message = _printable(finding.lines[0])
        ElementTree.SubElement(case, "failure", message=message, type="violation").text = text
    elif finding.outcome is Outcome.NOT_APPLICABLE:
        ElementTree.SubElement(case, "skipped", message=_printable(finding.lines[0]))
    elif finding.outcome is Outcome.KNOWN_LIMIT:
        message = f"known limit {finding.limit}: {_SENTENCES[finding.limit]}"
        ElementTree.SubElement(case, "skipped", message=message).text = text


def _printable(text: str) -> str:
    """Without the control characters that XML cannot hold."""
    return "".join(c if c in "\t\n" or ord(c) >= 32 else "\N{REPLACEMENT CHARACTER}" for c in text)
