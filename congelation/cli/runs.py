"""Commands that run scenarios: `run`, `sweep`, `export-ssp`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from congelation.cli.progress import Form, shown
from congelation.cli.shared import (
    FAILED,
    INTERRUPTED,
    as_status,
    complain,
    print_figures,
    print_summary,
)
from congelation.cosim.result import Status
from congelation.errors import CongelationError, InvalidInput
from congelation.results.records import Row
from congelation.results.store import Store
from congelation.scenario.load import load_scenario
from congelation.scenario.scenario import Scenario
from congelation.scenario.ssp import read_ssp, write_ssp
from congelation.sweep.batch import run_sweep
from congelation.sweep.estimate import estimate
from congelation.sweep.executors import Cluster, Processes, Workers
from congelation.sweep.run import run_scenario
from congelation.sweep.shipping import cargo_of
from congelation.sweep.sweep_plan import Plan, plan_sweep
from congelation.sweep.workers import REFUSED
from congelation.verify.reference import LARGEST_DEVIATION

__all__ = ["export_ssp", "run", "sweep"]

MEASURED = 50
"""A sweep of so many runs begins with an estimate of what it takes, which itself takes seconds."""


def run(
    scenario: Annotated[
        Path, typer.Argument(help="Scenario (.toml) or system (.ssp).", show_default=False)
    ],
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
        store = _run_with_progress(_read(scenario), folder, verify)
    except KeyboardInterrupt as error:
        complain("interrupted")
        raise typer.Exit(INTERRUPTED) from error
    print_summary(store)
    print_figures(store)
    print(store.index)
    complaints = list(_complaints(store))
    for complaint in complaints:
        complain(complaint)
    if complaints:
        raise typer.Exit(FAILED)


def sweep(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml).", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option(help="Result directory.", show_default="results/<scenario>", metavar="DIR"),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Number of processes.", show_default="1")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="dask scheduler to use instead.", metavar="ADDRESS", show_default=False),
    ] = None,
    ship: Annotated[
        bool,
        typer.Option(
            "--ship",
            help="Send FMUs to the workers of the scheduler, and take results from them.",
        ),
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Do what is missing in the result directory.")
    ] = False,
    retry: Annotated[
        list[str] | None,
        typer.Option(
            help="Resume, and do runs that ended so again (repeatable): timed_out, worker_died, ..",
            metavar="STATUS",
            show_default=False,
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what there is to do and what it takes, and stop.")
    ] = False,
    progress: Annotated[
        Form, typer.Option(help="A bar, one line of JSON at a time, or nothing.")
    ] = Form.BAR,
) -> None:
    """Run all variants at every point of the scenario's sweep, in worker processes."""
    folder = out if out is not None else Path("results") / scenario.stem
    if workers is not None and scheduler is not None:
        raise InvalidInput("give --workers or --scheduler, not both")
    if ship and scheduler is None:
        raise InvalidInput("--ship needs a --scheduler to send FMUs to; processes here have them")
    again = [as_status(status) for status in retry or ()]
    plan = plan_sweep(_read(scenario), folder, resume=bool(resume or dry_run or again), retry=again)
    place = _place(plan, workers or 1, scheduler, ship=ship)
    try:
        _announce(plan, place, folder, measured=dry_run or len(plan.missing) >= MEASURED)
        if dry_run:
            return
        with shown(plan, progress) as listener:
            run_sweep(plan, workers=place, progress=listener)
    except KeyboardInterrupt as error:
        total = len(plan.run_ids)
        complain(f"interrupted after {plan.finished} of {total} runs; go on with --resume")
        raise typer.Exit(INTERRUPTED) from error
    print_summary(Store(folder))
    print(Store(folder).index)
    _tell_failures(scenario, Store(folder).read().rows)


def export_ssp(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml).", show_default=False)],
    file: Annotated[
        Path, typer.Argument(help="The file to write.", metavar="FILE.ssp", show_default=False)
    ],
    variant: Annotated[
        str | None, typer.Option(help="Variant to export.", show_default="the first")
    ] = None,
    derivatives: Annotated[
        bool, typer.Option("--derivatives", help="Connect der(..) outputs to der(..) inputs, too.")
    ] = False,
) -> None:
    """Write a scenario as a system that other tools can open: SSP 1.0 with the FMUs inside."""
    write_ssp(load_scenario(scenario), file, variant, derivatives=derivatives)
    print(file)


def _read(file: Path) -> Scenario:
    return read_ssp(file) if file.suffix == ".ssp" else load_scenario(file)


def _place(plan: Plan, workers: int, scheduler: str | None, *, ship: bool) -> Workers:
    """Where the runs are done."""
    if scheduler is None:
        return Processes(workers)
    return Cluster(scheduler, cargo_of(plan.shared, plan.missing) if ship else None)


def _announce(plan: Plan, place: Workers, folder: Path, *, measured: bool) -> None:
    """Say how many runs there are, and what those missing will take."""
    print(f"{len(plan.run_ids)} runs, {len(plan.missing)} of them to do in {folder}")
    if plan.others:
        print(f"{plan.others} runs there are of another state of the scenario, and not listed")
    if not (measured and plan.missing):
        return
    try:
        print(estimate(plan, place), flush=True)
    except InvalidInput:
        raise
    except CongelationError as error:
        print(f"no estimate: {error}", flush=True)


def _tell_failures(scenario: Path, rows: Sequence[Row]) -> None:
    """Say how many runs failed, and how; raise InvalidInput if not one could begin."""
    failed = [row for row in rows if row["status"] != Status.COMPLETED.name]
    if not failed:
        return
    kinds = Counter(str(row["status"]) for row in failed)
    counts = ", ".join(f"{count} {status}" for status, count in kinds.most_common())
    complain(f"{len(failed)} of {len(rows)} runs failed ({counts})")
    if kinds[REFUSED] == len(rows):
        raise InvalidInput(f"{scenario}: {failed[0]['message']}")


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
