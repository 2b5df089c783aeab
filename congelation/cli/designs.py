"""Commands on designs: `certify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from congelation.cli.shared import FAILED, complain, print_table
from congelation.verify.certify import Certification, designs_of
from congelation.verify.certify import certify as search

__all__ = ["certify"]


def certify(
    file: Annotated[Path, typer.Argument(help="Spec or scenario (.toml).", show_default=False)],
    samples: Annotated[int, typer.Option(min=1, help="Random states to try.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Of the random states.")] = 0,
) -> None:
    """Search for states where V' exceeds the rate that a design promises; exit code 1 if found."""
    found = [search(design, samples, seed) for design in designs_of(file)]
    print_table(
        f"{file}",
        ["worst margin", "relative", "delta", "radius of theta", ""],
        [_line(c) for c in found],
    )
    failed = [c for c in found if not c.holds]
    for certification in failed:
        complain(f"{certification.design.name}: {_why(certification)}")
    if failed:
        raise typer.Exit(FAILED)


def _line(found: Certification) -> tuple[str, list[str]]:
    margin = found.finding.margin
    return found.design.name, [
        f"{margin.value:.3g}",
        f"{margin.relative:.1e}",
        f"{found.delta:.4g}",
        f"{found.design.radius:.4g}",
        "holds" if found.holds else "violated",
    ]


def _why(found: Certification) -> str:
    if found.finding.violated:
        state = ", ".join(f"{name} = {value:.4g}" for name, value in found.finding.state.items())
        return f"V' + promised rate = {found.finding.margin.value:.4g} > 0 at {state}"
    return (
        f"theta(t) fills a box of radius {found.design.radius:.4g}, the design is made for "
        f"delta = {found.delta:.4g}; set delta to that radius, or narrow the profile"
    )
