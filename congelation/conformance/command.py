"""The command `congelation check`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress

from congelation.conformance.report import print_report, to_json, to_junit
from congelation.conformance.rule import DEFAULT_TIME_LIMIT, Finding, Outcome
from congelation.conformance.rules import RULES
from congelation.conformance.runner import run, select
from congelation.errors import InvalidInput

__all__ = ["check"]


def check(
    fmus: Annotated[
        list[Path], typer.Argument(metavar="FMU...", help="The FMUs.", show_default=False)
    ],
    junit: Annotated[Path | None, typer.Option(help="Write JUnit XML to this file.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write JSON to this file.")] = None,
    rule: Annotated[
        list[str] | None,
        typer.Option(help="Only this rule, or family of rules (FMI2-STATE); may be repeated."),
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Rules run at the same time.")] = None,
    time_limit: Annotated[
        float, typer.Option(min=0.1, help="Seconds that a rule may take.")
    ] = DEFAULT_TIME_LIMIT,
    everything: Annotated[
        bool, typer.Option("--all", help="Show rules that passed or do not apply, too.")
    ] = False,
) -> None:
    """Check FMUs against the rules of FMI 2.0 for co-simulation; exit code 1 on a violation."""
    try:
        rules = select(rule) if rule else RULES
    except InvalidInput as error:
        raise typer.BadParameter(str(error), param_hint="--rule") from error
    missing = [path for path in fmus if not path.is_file()]
    if missing:
        raise typer.BadParameter(f"there is no FMU at '{missing[0]}'", param_hint="FMUS")
    console = Console()
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("checking", total=len(fmus) * len(rules))

        def advance(path: Path, finding: Finding) -> None:
            colour = "red" if finding.outcome is Outcome.VIOLATION else "default"
            text = f"[{colour}]{path.name} {finding.rule.id}"
            progress.update(task, advance=1, description=text)

        report = run(fmus, rules=rules, jobs=jobs, time_limit=time_limit, progress=advance)
    print_report(report, console, everything=everything)
    for target, text in ((junit, to_junit), (json, to_json)):
        if target is not None:
            target.write_text(text(report) + "\n", encoding="utf-8")
    if report.violations:
        raise typer.Exit(1)
