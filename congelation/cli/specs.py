"""Commands on specs and FMUs: `new`, `examples`, `build`, `info`, `certify`."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from congelation.cli.shared import BAD_INPUT, FAILED, VIOLATED, complain, print_json, print_table
from congelation.cosim.pair_info import info as look_at
from congelation.errors import CongelationError, DesignWarning, InvalidInput, counted
from congelation.export.build import build as build_fmus
from congelation.export.examples import copy_examples, write_starter
from congelation.export.spec import IsBlock
from congelation.places import check_file
from congelation.report.certificates import SHORT, write_certificates
from congelation.verify.certify import Certification, Verdict
from congelation.verify.certify import certify as search

__all__ = ["build", "certify", "examples", "info", "new"]

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def new(
    name: Annotated[
        str, typer.Argument(help="Name of the new folder and of the FMUs.", show_default=False)
    ],
    source: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="FILE",
            help="A transfer function with intervals for its coefficients (.toml).",
            show_default="an example",
        ),
    ] = None,
    spread: Annotated[
        float,
        typer.Option(
            min=0.0,
            help="With --from: a coefficient of the denominator given as one number becomes an "
            "interval that reaches this far to either side, relative to the number.",
        ),
    ] = 0.0,
) -> None:
    """Write a commented spec and scenario to start from, into the new folder NAME."""
    folder = write_starter(name, source=source, spread=spread)
    for line in (
        f"congelation build {folder / 'spec.toml'} --out {folder / 'fmus'}",
        f"congelation certify {folder / 'spec.toml'}",
        f"congelation run {folder / 'scenario.toml'}",
    ):
        print(line)


def examples(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="Folder to copy the examples to.", show_default=False),
    ],
) -> None:
    """Copy the example specs and scenarios into the folders specs and scenarios of DIR."""
    files = copy_examples(folder)
    print(f"{counted(len(files), 'file')} in {folder / 'specs'} and {folder / 'scenarios'}")


def build(
    specs: Annotated[
        list[Path], typer.Argument(metavar="SPEC...", help="Specs (.toml).", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="Folder for the FMUs.", metavar="DIR")] = Path("fmus"),
    native: Annotated[
        bool,
        typer.Option(
            "--native", help="Build native FMUs, which run without Python, into DIR/native."
        ),
    ] = False,
    platform: Annotated[
        list[str] | None,
        typer.Option(
            help="What native FMUs are to run on: linux64, win64 (with linux64 in one file), "
            "aarch64-linux, darwin64 (files of their own in DIR/native/NAME). Repeatable, or "
            "separated by commas. All but linux64 need the extra native-platforms.",
            metavar="NAME",
            show_default="linux64",
        ),
    ] = None,
    c_code: Annotated[
        bool,
        typer.Option(
            "--c-code", help="The bare controllers as C for sampled control instead, into DIR/c."
        ),
    ] = False,
) -> None:
    """Build the plant and the controller FMUs of specs."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", DesignWarning)
        platforms = [name.strip() for given in platform or () for name in given.split(",")]
        paths = build_fmus(*specs, out=out, native=native, platforms=platforms, c_code=c_code)
    for warning in found:
        complain(f"warning: {warning.message}")
    for path in paths:
        print(path)


def info(
    fmu: Annotated[Path, typer.Argument(metavar="FMU", help="An FMU.", show_default=False)],
    other: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FMU]", help="A second FMU to connect it with.", show_default=False
        ),
    ] = None,
    stop_time: Annotated[
        float | None,
        typer.Option(
            help="Length of the trial runs of a pair in s.",
            show_default="the shorter stop time that the FMUs propose, or 10",
        ),
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
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="Specs or scenarios (.toml).", show_default=False),
    ],
    samples: Annotated[int, typer.Option(min=1, help="Random states to try.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random states.")] = 0,
    umax: Annotated[
        float | None,
        typer.Option(
            help="Limit of |u|: find the level set of V in which the control never saturates.",
            show_default="none",
        ),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(help="Write a page for people, of one FILE.", metavar="PAGE"),
    ] = None,
    json: AsJson = False,
) -> None:
    """Check the assumptions of designs, and search for states where V' exceeds its promise.

    Exit code 0: every design holds; 3: one is violated or breaks an assumption; 2: a file is wrong;
    1: of one nothing can be said, because its law has no certificate or double precision does not
    suffice. Of several files the highest of their codes; those of blocks have nothing to certify.
    """
    if html is not None:
        if len(files) > 1:
            raise InvalidInput("--html is the page of one file; give one, or leave it out")
        check_file("--html", html)
    several, code = len(files) > 1, 0
    records: list[object] = []
    for file in files:
        try:
            found = search(file, samples=samples, seed=seed, umax=umax)
        except CongelationError as error:
            if not several:
                raise
            complain(str(error))
            records.append({"file": str(file), "error": str(error), "designs": []})
            if not isinstance(error, IsBlock):
                code = max(code, BAD_INPUT if isinstance(error, InvalidInput) else FAILED)
            continue
        if html is not None:
            write_certificates(found, file, html, samples=samples, seed=seed)
        own = [_record(certification) for certification in found]
        records += [{"file": str(file), "error": None, "designs": own}] if several else own
        if several and not json:
            for name, (*numbers, verdict) in map(_line, found):
                what = ", ".join(f"{head} {n}" for head, n in zip(HEADS, numbers, strict=True))
                print(f"{file}: {name}: {verdict} ({what})", flush=True)
        # Of a design that nothing was searched of, the verdict and its reason say all.
        elif not json and (searched := [one for one in found if one.finding is not None]):
            print_table(f"{file}", [*HEADS, "result"], [_line(one) for one in searched])
        _tell(found, f"{file}: " if several else "", json=json)
        verdicts = {certification.verdict for certification in found}
        if verdicts & {Verdict.VIOLATED, Verdict.ASSUMPTION_BROKEN}:
            code = VIOLATED
        elif verdicts - {Verdict.HOLDS}:
            code = max(code, FAILED)
    if json:
        print_json(records)
    if code:
        raise typer.Exit(code)


HEADS = ("worst margin", "relative margin", "delta", "radius of theta")
"""What is said of a design besides its verdict."""


def _tell(found: Sequence[Certification], place: str, *, json: bool) -> None:
    """Say what there is to say of designs besides the numbers of the search."""
    for certification in found:
        name = f"{place}{certification.design.name}"
        for warning in certification.warnings:
            complain(f"{name}: warning: {warning}")
        if certification.level is not None and not json:
            level = certification.level
            side = "starts inside" if level.holds_start else "starts outside"
            print(
                f"{name}: |u| < {level.umax:g} where V < {level.v:.4g}; the design {side}, at "
                f"V = {level.start:.4g}"
            )
        if certification.ultimate is not None and not json:
            print(f"{name}: under leakage V ends below {certification.ultimate:.4g}")
        if certification.unlevelled:
            complain(f"{name}: no level set within the limits: {certification.unlevelled}")
        for reason in certification.reasons:
            complain(f"{name}: {certification.verdict.value}: {reason}")


def _record(found: Certification) -> dict[str, object]:
    finding = found.finding
    return {
        "design": found.design.name,
        "verdict": found.verdict.name,
        "reasons": list(found.reasons),
        "warnings": list(found.warnings),
        "margin": None if finding is None else finding.margin.value,
        "relative_margin": None if finding is None else finding.margin.relative,
        "state": {} if finding is None else dict(finding.state),
        "level": None
        if found.level is None
        else {
            "umax": found.level.umax,
            "v": found.level.v,
            "start": found.level.start,
            "state": dict(found.level.state),
        },
        "unlevelled": found.unlevelled,
        "ultimate": found.ultimate,
        "delta": found.delta,
        "radius": found.design.radius,
    }


def _line(found: Certification) -> tuple[str, list[str]]:
    margin = None if found.finding is None else found.finding.margin
    return found.design.name, [
        "unknown" if margin is None else f"{margin.value:.3g}",
        "unknown" if margin is None else f"{margin.relative:.1e}",
        "any" if found.delta is None else f"{found.delta:.4g}",
        f"{found.design.radius:.4g}",
        SHORT[found.verdict],
    ]
