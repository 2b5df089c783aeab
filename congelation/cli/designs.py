"""Commands on designs: `certify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from congelation.cli.shared import FAILED, VIOLATED, complain, print_table
from congelation.verify.certify import Certification, Verdict, designs_of
from congelation.verify.certify import certify as search

__all__ = ["certify"]

_SHORT = {
    Verdict.HOLDS: "holds",
    Verdict.VIOLATED: "violated",
    Verdict.NOT_CLAIMED: "no certificate",
    Verdict.ASSUMPTION_BROKEN: "assumption",
    Verdict.PRECISION: "precision",
}
"""The verdicts as cells of a table."""


def certify(
    file: Annotated[Path, typer.Argument(help="Spec or scenario (.toml).", show_default=False)],
    samples: Annotated[int, typer.Option(min=1, help="Random states to try.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Of the random states.")] = 0,
) -> None:
    """Check the assumptions of a design, and search for states where V' exceeds its promise.

    Exit code 0: every design holds; 3: one is violated or breaks an assumption; 1: of one nothing
    can be said, because its law has no certificate or double precision does not suffice.
    """
    found = [search(design, samples, seed) for design in designs_of(file)]
    print_table(
        f"{file}",
        ["worst margin", "relative", "delta", "radius of theta", ""],
        [_line(c) for c in found],
    )
    for certification in found:
        name = certification.design.name
        for warning in certification.warnings:
            complain(f"{name}: warning: {warning}")
        for reason in certification.reasons:
            complain(f"{name}: {certification.verdict.value}: {reason}")
    verdicts = {certification.verdict for certification in found}
    if verdicts & {Verdict.VIOLATED, Verdict.ASSUMPTION_BROKEN}:
        raise typer.Exit(VIOLATED)
    if verdicts - {Verdict.HOLDS}:
        raise typer.Exit(FAILED)


def _line(found: Certification) -> tuple[str, list[str]]:
    margin = None if found.finding is None else found.finding.margin
    return found.design.name, [
        "" if margin is None else f"{margin.value:.3g}",
        "" if margin is None else f"{margin.relative:.1e}",
        f"{found.delta:.4g}",
        f"{found.design.radius:.4g}",
        _SHORT[found.verdict],
    ]
