"""The command line: ``congelation COMMAND``; every command is a thin layer over the packages.

Exit codes: 0 done; 1 a run failed or a check did not hold; 2 the input or the usage is wrong;
130 interrupted.
What a user can set right is one line on stderr, never a traceback.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from congelation.cosim.result import Status
from congelation.errors import CongelationError, InvalidInput
from congelation.report.figures import draw, figure_names, save
from congelation.report.html import write_html
from congelation.report.summary import summarise
from congelation.study.batch import Plan, plan_sweep, run_sweep
from congelation.study.run import run_scenario
from congelation.study.scenario import Scenario
from congelation.study.scenario_file import load_scenario
from congelation.study.store import Store, code_version
from congelation.study.verify import LARGEST_DEVIATION

__all__ = ["app", "main"]

FAILED, BAD_INPUT, INTERRUPTED = 1, 2, 130

app = typer.Typer(
    name="congelation",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the command line and exit."""
    try:
        app()
    except InvalidInput as error:
        _complain(str(error))
        sys.exit(BAD_INPUT)
    except CongelationError as error:
        _complain(str(error))
        sys.exit(FAILED)


def _complain(text: str) -> None:
    print(f"congelation: {' '.join(text.split())}", file=sys.stderr)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"congelation {code_version()}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    """Adaptive control of linear systems with time-varying parameters, co-simulated as FMUs."""


@app.command()
def run(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml).", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option(help="Result directory.", show_default="results/<scenario>", metavar="DIR"),
    ] = None,
    verify: Annotated[
        bool, typer.Option("--verify", help="Compare with a monolithic solution.")
    ] = False,
) -> None:
    """Run all variants of a scenario: summary, trajectories and figures."""
    folder = out if out is not None else Path("results") / scenario.stem
    try:
        store = _run_with_progress(load_scenario(scenario), folder, verify)
    except KeyboardInterrupt as error:
        _complain("interrupted")
        raise typer.Exit(INTERRUPTED) from error
    _print_summary(store)
    _print_figures(store)
    print(store.index)
    complaints = list(_complaints(store))
    for complaint in complaints:
        _complain(complaint)
    if complaints:
        raise typer.Exit(FAILED)


@app.command()
def sweep(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml).", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option(help="Result directory.", show_default="results/<scenario>", metavar="DIR"),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Number of processes.")] = 1,
    resume: Annotated[
        bool, typer.Option("--resume", help="Do what is missing in the result directory.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say how many runs there are, and stop.")
    ] = False,
) -> None:
    """Run all variants at every point of the scenario's sweep, in worker processes."""
    folder = out if out is not None else Path("results") / scenario.stem
    plan = plan_sweep(load_scenario(scenario), folder, resume=resume or dry_run)
    print(f"{len(plan.run_ids)} runs, {len(plan.missing)} of them to do in {folder}")
    if dry_run:
        return
    try:
        store = _sweep_with_progress(plan, workers)
    except KeyboardInterrupt as error:
        done = len(plan.shared.store.finished())
        _complain(f"interrupted after {done} of {len(plan.run_ids)} runs; go on with --resume")
        raise typer.Exit(INTERRUPTED) from error
    _print_summary(store)
    print(store.index)


@app.command()
def report(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Result directory.", show_default=False)
    ],
    html: Annotated[
        Path | None, typer.Option(help="Also write one self-contained HTML file.", metavar="FILE")
    ] = None,
) -> None:
    """Summarise a result directory and draw its figures, from stored results alone."""
    store = Store(folder)
    _print_summary(store)
    _print_figures(store)
    if html is not None:
        write_html(store, html)
        print(html)


def _sweep_with_progress(plan: Plan, workers: int) -> Store:
    columns = (
        TextColumn("{task.completed} of {task.total} runs, {task.fields[failed]} failed"),
        BarColumn(),
        TaskProgressColumn(show_speed=True),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        done = len(plan.run_ids) - len(plan.missing)
        task = bar.add_task("", total=len(plan.run_ids), completed=done, failed=0)
        return run_sweep(
            plan,
            workers=workers,
            progress=lambda done, failed: bar.update(task, completed=done, failed=failed),
        )


def _run_with_progress(scenario: Scenario, folder: Path, verify: bool) -> Store:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        names = [variant.name for variant in scenario.variants]
        tasks = {name: bar.add_task(escape(name), total=1.0, start=False) for name in names}

        def show(variant: str, done: float) -> None:
            bar.start_task(tasks[variant])
            bar.update(tasks[variant], completed=done)

        return run_scenario(scenario, folder, verify=verify, progress=show)


def _print_summary(store: Store) -> None:
    study = store.read()
    summary = summarise(study)
    table = Table(title=escape(study.about["title"]), title_justify="left")
    table.add_column("")
    for column in summary.columns:
        table.add_column(escape(column), justify="right")
    for label, cells in summary.lines:
        table.add_row(escape(label), *(escape(cell) for cell in cells))
    Console().print(table)


def _print_figures(store: Store) -> None:
    for name in figure_names(store):
        for file in save(draw(store, name), store.root / "figures", name):
            print(file)


def _complaints(store: Store) -> Iterator[str]:
    """What did not go as it should: failed runs, and runs too far from the reference."""
    study = store.read()
    for row in study.rows:
        if row["status"] != Status.COMPLETED.name:
            yield f"{row['variant']}: {row['message']}"
        for deviation in study.about["verification"].get(row["run_id"], []):
            if deviation["relative"] > LARGEST_DEVIATION:
                yield (
                    f"{row['variant']}: {deviation['variable']} is off the monolithic solution by "
                    f"{deviation['relative']:.1e} of its peak (at most {LARGEST_DEVIATION:g}); "
                    "shorten the communication step"
                )
