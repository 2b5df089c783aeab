"""The page of `congelation check`: the findings in each FMU, and what became of every rule."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

from congelation.conformance.finding import Finding, FmuReport, Report, Verdict
from congelation.conformance.report import words_of
from congelation.conformance.rule import Level, Outcome
from congelation.places import write_whole
from congelation.report.page_shell import opening, pairs, plain_page, table, tile
from congelation.results.identity import code_version

__all__ = ["write_conformance"]


def write_conformance(report: Report, file: Path) -> None:
    """Write what the rules found as one self-contained page.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    fmus = report.fmus
    title = "Conformance with FMI 2.0" + (f": {fmus[0].path.name}" if len(fmus) == 1 else "")
    pieces = [
        *opening(title, _verdict(report)),
        '<div class="tiles">',
        *(piece for fmu in fmus for piece in _tile(fmu)),
        "</div>",
        *(piece for fmu in fmus for piece in _fmu(fmu)),
        *(
            f'<p class="note">Of the known findings nothing was found for {escape(entry)}; '
            "remove the entry.</p>"
            for entry in report.unused
        ),
        "<details><summary>Provenance</summary>",
        *pairs([("congelation", code_version()), ("standard", "FMI 2.0.5")]),
        "</details></main>",
    ]
    text = plain_page(title, pieces)
    write_whole(file, text)


def _verdict(report: Report) -> Iterator[str]:
    """What was found in all FMUs, the gravest first."""
    checked = [fmu for fmu in report.fmus if fmu.in_scope]
    where = f"in {len(checked)} FMUs" if len(checked) != 1 else f"in {checked[0].path.name}"
    if not checked:
        yield "Nothing could be checked."
        return
    counts = []
    for level in Level:
        count = sum(f.level is level and not f.known for f in report.findings)
        counts.append(f"{count} {_plural(level, count)}")
    violations = [
        fmu.path.name
        for fmu in checked
        if any(f.level is Level.VIOLATION and not f.known for f in fmu.findings)
    ]
    if violations:
        yield f"The standard is violated by {', '.join(violations)}."
    else:
        yield f"No violation of the standard was found {where}."
    known = sum(bool(f.known) for f in report.findings)
    yield f"{', '.join(counts)}{f'; {known} accepted' if known else ''}."
    verdicts = [verdict for fmu in checked for verdict in fmu.verdicts]
    reasons = {v.reason for v in verdicts if v.outcome is Outcome.NOT_EVALUATED}
    if reasons:
        left = sum(v.outcome is Outcome.NOT_EVALUATED for v in verdicts)
        why = reasons.pop() if len(reasons) == 1 else "the reasons are below"
        yield f"{left} of {len(verdicts)} rules were not evaluated: {why}."
    skipped = len(report.fmus) - len(checked)
    if skipped:
        yield f"{skipped} of the FMUs could not be checked."


def _plural(level: Level, count: int) -> str:
    words = {Level.ROBUSTNESS: ("finding on robustness", "findings on robustness")}
    one, many = words.get(level, (level.value, f"{level.value}s"))
    return one if count == 1 else many


def _tile(fmu: FmuReport) -> Iterator[str]:
    own = [finding for finding in fmu.findings if not finding.known]
    lines = [(level.value, str(sum(f.level is level for f in own))) for level in Level]
    lines += [(o.value, str(fmu.count(o))) for o in Outcome if o is not Outcome.FOUND]
    violated = any(finding.level is Level.VIOLATION for finding in own)
    shade = "var(--bad)" if violated else "var(--good)"
    if not fmu.in_scope:
        lines, shade = [("not checked", "–")], "var(--line)"
    yield from tile(f'<a href="#{_anchor(fmu)}">{escape(fmu.path.name)}</a>', shade, lines)


def _anchor(fmu: FmuReport) -> str:
    return escape(f"fmu-{str(fmu.path).replace(' ', '-')}", quote=True)


def _fmu(fmu: FmuReport) -> Iterator[str]:
    yield f'<h2 id="{_anchor(fmu)}">{escape(fmu.path.name)}</h2>'
    yield f'<p class="note">{escape(str(fmu.path))}: {escape(fmu.scope)}</p>'
    broken = [v for v in fmu.verdicts if v.outcome in (Outcome.FOUND, Outcome.KNOWN)]
    both = sorted(
        zip(fmu.findings, broken, strict=True),
        key=lambda entry: (bool(entry[0].known), entry[0].level.weight),
    )
    for finding, verdict in both:
        yield from _finding(finding, verdict)
    if fmu.in_scope and not both:
        yield "<p>No rule is broken.</p>"
    yield from _left_out(fmu.verdicts)
    if fmu.verdicts:
        yield f"<details><summary>All {len(fmu.verdicts)} rules</summary>"
        lines = [
            (v.rule.id, [v.rule.level.value, v.rule.section, v.outcome.value, v.rule.sentence])
            for v in fmu.verdicts
        ]
        yield from table(
            ["a finding is a", "section", "outcome", "what it demands"],
            lines,
            "What became of every rule",
            text=True,
        )
        yield "</details>"


def _finding(finding: Finding, verdict: Verdict) -> Iterator[str]:
    """A broken rule: what, where, the remedy; folded, all that was seen and the rule itself."""
    level = finding.level.value
    kind, accepted = ("known", ", accepted") if finding.known else (level, "")
    place = finding.file + (f", line {finding.line}" if finding.line else "")
    yield f'<section class="finding {kind}">'
    yield f"<h3>{finding.rule}: {level}{accepted}</h3>"
    yield f"<p>{escape(finding.what)}{f' <small>({escape(place)})</small>' if place else ''}</p>"
    if finding.known:
        yield f"<p>Accepted: {escape(finding.known)}</p>"
    yield f"<p>Remedy: {escape(finding.remedy)}</p>"
    yield "<details><summary>All that was seen, and the rule</summary><ul>"
    for line in words_of(verdict):
        yield f"<li>{escape(line)}</li>"
    yield "</ul>"
    for paragraph in verdict.rule.page().split("\n\n"):
        yield f"<p>{escape(paragraph)}</p>"
    yield "</details></section>"


def _left_out(verdicts: Sequence[Verdict]) -> Iterator[str]:
    """The rules that did not look, by their reason."""
    reasons: dict[str, list[str]] = {}
    for verdict in verdicts:
        if verdict.outcome is Outcome.NOT_EVALUATED:
            reasons.setdefault(verdict.reason, []).append(verdict.rule.id)
    if reasons:
        yield "<details><summary>Rules that were not evaluated</summary>"
        yield from pairs((", ".join(rules), reason) for reason, rules in reasons.items())
        yield "</details>"
