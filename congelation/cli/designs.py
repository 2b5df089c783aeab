"""Commands on specs and FMUs: `new`, `examples`, `build`, `info`, `certify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from congelation.cli.shared import VIOLATED, complain, print_json, print_table
from congelation.cosim.info import info as look_at
from congelation.export.build import build as build_fmus
from congelation.export.examples import copy_examples, write_starter
from congelation.verify.certify import Certification, designs_of
from congelation.verify.certify import certify as search

__all__ = ["build", "certify", "examples", "info", "new"]

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def new(
    name: Annotated[
        str, typer.Argument(help="Of the folder to make, and of the FMUs.", show_default=False)
    ],
) -> None:
    """Write a commented spec and scenario to start from, into the new folder NAME."""
    folder = write_starter(name)
    for line in (
        f"congelation build {folder / 'spec.toml'} --out {folder / 'fmus'}",
        f"congelation certify {folder / 'spec.toml'}",
        f"congelation run {folder / 'scenario.toml'}",
    ):
        print(line)


def examples(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Where to copy them.", show_default=False)
    ],
) -> None:
    """Copy the example specs and scenarios into the folders specs and scenarios of DIR."""
    files = copy_examples(folder)
    print(f"{len(files)} files in {folder / 'specs'} and {folder / 'scenarios'}")


def build(
    specs: Annotated[
        list[Path], typer.Argument(metavar="SPEC...", help="Specs (.toml).", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="Folder for the FMUs.", metavar="DIR")] = Path("fmus"),
) -> None:
    """Build the plant and the controller FMUs of specs."""
    for path in build_fmus(*specs, out=out):
        print(path)


def info(
    fmu: Annotated[Path, typer.Argument(metavar="FMU", help="An FMU.", show_default=False)],
    other: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FMU]", help="A second one, to connect it with.", show_default=False
        ),
    ] = None,
    stop_time: Annotated[
        float | None,
        typer.Option(help="Seconds of trial runs of a pair.", show_default="what the FMUs propose"),
    ] = None,
    json: AsJson = False,
) -> None:
    """Say what an FMU is, what to connect and what to set; of a pair, which steps it can take."""
    found = look_at(fmu, *([] if other is None else [other]), stop_time=stop_time)
    if json:
        print_json(found)
    else:
        print(found)


def certify(
    file: Annotated[Path, typer.Argument(help="Spec or scenario (.toml).", show_default=False)],
    samples: Annotated[int, typer.Option(min=1, help="Random states to try.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Of the random states.")] = 0,
    json: AsJson = False,
) -> None:
    """Search for states where V' exceeds the rate that a design promises; exit code 3 if found."""
    found = [search(design, samples, seed) for design in designs_of(file)]
    if json:
        print_json([_record(c) for c in found])
    else:
        print_table(
            f"{file}",
            ["worst margin", "relative", "delta", "radius of theta", ""],
            [_line(c) for c in found],
        )
    failed = [c for c in found if not c.holds]
    for certification in failed:
        complain(f"{certification.design.name}: {_why(certification)}")
    if failed:
        raise typer.Exit(VIOLATED)


def _record(found: Certification) -> dict[str, object]:
    return {
        "design": found.design.name,
        "holds": found.holds,
        "margin": found.finding.margin.value,
        "relative_margin": found.finding.margin.relative,
        "state": dict(found.finding.state),
        "delta": found.delta,
        "radius": found.design.radius,
    }


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
