"""The page of `congelation certify`: what each design promises, and what the search met."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from congelation.places import shipped, write_whole
from congelation.report.page_shell import lines_of, opening, pairs, plain_page, table, tile
from congelation.report.summary import number
from congelation.results.identity import code_version
from congelation.verify.certify import Certification, Verdict

__all__ = ["SHORT", "write_certificates"]

SHORT: Mapping[Verdict, str] = {
    Verdict.HOLDS: "holds",
    Verdict.VIOLATED: "violated",
    Verdict.NOT_CLAIMED: "no certificate",
    Verdict.ASSUMPTION_BROKEN: "assumption broken",
    Verdict.PRECISION: "beyond double precision",
}
"""The verdicts in a word or two."""

_CLAIM = (
    "Each design promises V' ≤ −rate + residue for every θ(t) whose distance from the centre of "
    "its box is at most δ. The search draws states at random and climbs from the worst of them; at "
    "each state the worst θ is known in closed form. The margin is V' + rate − residue: positive "
    "where the promise is broken. The relative margin is the margin divided by the sum of the "
    "sizes of its terms: up to 1e-9 it is rounding. A search proves nothing; it can only fail to "
    "find a violation."
)


def write_certificates(
    found: Sequence[Certification], source: Path, file: Path, *, samples: int, seed: int
) -> None:
    """Write what `certify` found as one self-contained page.

    Parameters
    ----------
    found : sequence of Certification
    source : Path
        The spec or scenario.
    file : Path
    samples, seed : int
        That the search was made with.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    sentences = [f"{one.design.name}: {one.verdict.value}." for one in found]
    pieces = [
        *opening(f"Certificate of {source.name}", sentences),
        '<div class="tiles">',
        *(piece for one in found for piece in _tile(one)),
        f'</div><p class="note">{escape(_CLAIM)}</p>',
        *(piece for one in found for piece in _design(one)),
        "<details><summary>Provenance</summary>",
        *pairs(
            [
                ("congelation", code_version()),
                ("random states", str(samples)),
                ("seed", str(seed)),
                ("file", str(source)),
            ]
        ),
        lines_of(source.read_text("utf-8", errors="replace")),
        "</details></main>",
    ]
    text = plain_page(f"Certificate of {source.name}", pieces)
    write_whole(file, text)


def _tile(found: Certification) -> Iterator[str]:
    lines = [("verdict", SHORT[found.verdict])]
    if found.finding is not None:
        lines.append(("worst margin", number(found.finding.margin.value)))
        lines.append(("relative margin", f"{found.finding.margin.relative:.1e}"))
    lines.append(("δ of the design", "any" if found.delta is None else number(found.delta)))
    lines.append(("radius of θ(t)", number(found.design.radius)))
    if found.level is not None:
        level = found.level
        lines.append((f"V where |u| < {level.umax:g}", f"below {number(level.v)}"))
        lines.append(("V at the start", number(level.start)))
    shade = "var(--good)" if found.holds else "var(--bad)"
    yield from tile(escape(found.design.name), shade, lines)


def _design(found: Certification) -> Iterator[str]:
    design = found.design
    yield f"<h2>{escape(design.name)}</h2>"
    for reason in found.reasons:
        yield f'<p class="failed">{escape(reason)}</p>'
    for warning in found.warnings:
        yield f'<p class="note">Warning: {escape(warning)}</p>'
    if not any(remark.broken for remark in design.remarks):
        yield "<p>No assumption of the theorem is known to be broken.</p>"
    if found.level is not None:
        level = found.level
        side = "inside it" if level.holds_start else "outside it"
        yield (
            f"<p>|u| stays below {level.umax:g} where V &lt; {number(level.v)}; the design starts "
            f"{side}, at V = {number(level.start)}.</p>"
        )
    if found.unlevelled:
        yield f"<p>No level set within the limits of u: {escape(found.unlevelled)}.</p>"
    if found.finding is not None:
        finding, margin = found.finding, found.finding.margin
        lines = [
            ("V", [number(margin.V)]),
            ("V', the largest that θ allows", [number(margin.rate)]),
            ("promised rate of decay", [number(margin.claimed)]),
            ("residue", [number(margin.residue)]),
            ("margin", [number(margin.value)]),
            *((name, [number(value)]) for name, value in finding.state.items()),
        ]
        yield from table(["worst state"], lines, "The worst state that the search met")
        yield (
            f'<p class="note">States drawn: {finding.samples}; at {finding.discarded} a term '
            f"overflowed, at {finding.resolved} the promised rate stands out of the rounding.</p>"
        )
    yield "<details><summary>The design</summary>"
    yield from pairs(
        [
            *(
                (f"θ[{k}]", f"{number(middle - half)} to {number(middle + half)}")
                for k, (middle, half) in enumerate(zip(design.center, design.half, strict=True), 1)
            ),
            *((name, _array(value)) for name, value in design.loop.values.items()),
        ]
    )
    equations = shipped("fmu_src") / "equations" / f"{design.loop.controller.name}.html"
    if equations.is_file():
        yield f"<h3>{escape(design.loop.controller.name)}</h3>"
        yield equations.read_text("utf-8")
    yield "</details>"


def _array(value: object) -> str:
    """A number, or a vector or matrix row by row."""
    found = np.asarray(value)
    if found.size == 1:
        return number(float(found.item()))
    rows = found.reshape(found.shape[0], -1)
    return "; ".join(", ".join(number(float(entry)) for entry in row) for row in rows)
