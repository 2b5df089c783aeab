"""The command `congelation check`, a thin layer over `congelation.conformance.runner.check`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress

from congelation.cli.shared import BAD_INPUT, FAILED
from congelation.conformance.finding import FmuReport, Verdict
from congelation.conformance.report import to_json, to_junit, to_lines, to_table
from congelation.conformance.rule import BY_ID, DEFAULT_TIME_LIMIT, Level
from congelation.conformance.rules import RULES
from congelation.conformance.runner import check as run_check
from congelation.conformance.runner import select
from congelation.errors import InvalidInput, nearest
from congelation.places import check_file, write_whole
from congelation.report.conformance import write_conformance

__all__ = ["check"]


def _explain(name: str | None) -> None:
    """Print the page of a rule and end."""
    if name is None:
        return
    if name not in BY_ID:
        message = f"no rule is named '{name}': {nearest(name, BY_ID)}"
        raise typer.BadParameter(message, param_hint="--explain")
    print(BY_ID[name].page())
    raise typer.Exit


def check(
    fmus: Annotated[
        list[Path], typer.Argument(metavar="FMU...", help="The FMUs.", show_default=False)
    ],
    junit: Annotated[Path | None, typer.Option(help="Write JUnit XML to this file.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write JSON to this file.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write a page for people to this file.")] = None,
    static: Annotated[
        bool, typer.Option("--static", help="Look at the archive and its XML alone; seconds.")
    ] = False,
    fail_on: Annotated[
        Level, typer.Option(help="The least level of findings that make the exit code 1.")
    ] = Level.VIOLATION,
    known: Annotated[
        Path | None, typer.Option(help="TOML file of accepted findings (rule, fmu, reason).")
    ] = None,
    explain: Annotated[
        str | None,
        typer.Option(metavar="RULE", help="Explain a rule.", callback=_explain, is_eager=True),
    ] = None,
    rule: Annotated[
        list[str] | None,
        typer.Option(help="Only this rule, or family of rules (FMI2-STATE); may be repeated."),
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Rules run at the same time.")] = None,
    time_limit: Annotated[
        float, typer.Option(min=0.1, help="Seconds that a rule may take.")
    ] = DEFAULT_TIME_LIMIT,
    table: Annotated[
        bool, typer.Option("--table", help="Show what became of every rule, too.")
    ] = False,
) -> None:
    """Check FMUs against the rules of FMI 2.0; exit code 1 on a violation."""
    chosen = select(rule or ()) or RULES
    for option, target in (("--junit", junit), ("--json", json), ("--html", html)):
        if target is not None:
            if not target.absolute().parent.is_dir():
                raise InvalidInput(f"{option} {target}: there is no folder {target.parent}")
            check_file(option, target)
    console = Console(stderr=True)
    with Progress(
        console=console,
        transient=True,
        disable=not console.is_terminal,
        # Findings that go to a file must not be printed above the bar instead.
        redirect_stdout=sys.stdout.isatty(),
    ) as progress:
        task = progress.add_task("checking", total=len(fmus) * len(chosen))

        def advance(path: Path, verdict: Verdict) -> None:
            text = f"{path.name} {verdict.rule.id}"
            progress.update(task, advance=1, description=text)

        def announce(path: Path, scope: str) -> None:
            # Here and not at the end, because the rules may take minutes.
            progress.update(task, description=path.name)
            print(f"{path}: {scope}", flush=True)

        def tell(fmu: FmuReport) -> None:
            if table:
                Console().print(to_table(fmu))
            for line in to_lines(fmu):
                print(line, flush=True)

        report = run_check(
            fmus,
            rules=rule or (),
            static=static,
            known=known,
            jobs=jobs,
            time_limit=time_limit,
            opened=announce,
            progress=advance,
            done=tell,
        )
    for entry in report.unused:
        typer.echo(f"{known}: nothing was found for {entry}; remove the entry", err=True)
    for target, text in ((json, to_json(report)), (junit, to_junit(report, fail_on))):
        if target is not None:
            write_whole(target, f"{text}\n")
    if html is not None:
        write_conformance(report, html)
    if report.failures(fail_on):
        raise typer.Exit(FAILED)
    if not all(fmu.in_scope for fmu in report.fmus):
        raise typer.Exit(BAD_INPUT)
