"""Commands that run scenarios: `run`, `sweep`, `export-ssp`."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from congelation.cli.progress import Form, shown
from congelation.cli.shared import (
    FAILED,
    INTERRUPTED,
    as_status,
    complain,
    print_figures,
    print_json,
    print_summary,
)
from congelation.cosim.compiled import available
from congelation.errors import CongelationError, InvalidInput, counted
from congelation.places import check_file
from congelation.report.summary import without_effect
from congelation.results.identity import code_version
from congelation.results.record import RunRecord
from congelation.results.results import Results
from congelation.scenario.load import load_scenario
from congelation.scenario.scenario import Scenario
from congelation.scenario.ssp import write_ssp
from congelation.sweep.cluster import Cluster
from congelation.sweep.engine import carry_out, result_folder
from congelation.sweep.estimate import estimate
from congelation.sweep.local import Local
from congelation.sweep.plan import Plan, plan_study
from congelation.sweep.workers import Workers
from congelation.verify.reference import LARGEST_DEVIATION
from congelation.verify.scenario_assumptions import scenario_warnings, sweep_warnings

__all__ = ["export_ssp", "run", "sweep"]


class Bars(StrEnum):
    """What ``--trust`` asks for."""

    BARS = "bars"
    ORDER = "order"
    PROBE = "probe"


Out = Annotated[
    Path | None,
    typer.Option(help="Result directory.", show_default="results/<scenario>", metavar="DIR"),
]
Verify = Annotated[bool, typer.Option("--verify", help="Compare with a monolithic solution.")]
Trust = Annotated[
    Bars | None,
    typer.Option(
        help="Error bars, by a second run with every step halved; =order: whether errors fall as "
        "they should; =probe: whether an FMU steps inside on a grid of its own.",
        metavar="[=order|=probe]",
        show_default=False,
    ),
]
Timeout = Annotated[
    float | None,
    typer.Option(help="Seconds that a run may take.", metavar="SECONDS", show_default=False),
]
ProgressForm = Annotated[
    Form, typer.Option(help="How progress is shown: a bar, lines of JSON, or not at all.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON in place of tables.")]

Strict = Annotated[bool, typer.Option("--strict", help="Treat warnings as errors.")]

MOST_CAUSES = 3
"""Most causes of failure that are named at the end of a study."""

_NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")

MEASURED = 50
"""A sweep of so many runs begins with an estimate of what it takes, which itself takes seconds."""


def run(
    scenario: Annotated[
        Path, typer.Argument(help="Scenario (.toml) or system (.ssp).", show_default=False)
    ],
    out: Out = None,
    workers: Annotated[int, typer.Option(min=1, help="Number of processes.")] = 1,
    verify: Verify = False,
    trust: Trust = None,
    timeout: Timeout = None,
    progress: ProgressForm = Form.BAR,
    as_json: Json = False,
    strict: Strict = False,
    stop_time: Annotated[
        float | None,
        typer.Option(help="End of the run in s.", show_default="the scenario's", metavar="TIME"),
    ] = None,
    step: Annotated[
        float | None,
        typer.Option(
            help="Communication step in s, in place of a tolerance unless that is given, too.",
            show_default="the scenario's",
            metavar="TIME",
        ),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="Chooses the steps, in place of a fixed one.", show_default="the scenario's"
        ),
    ] = None,
    coupling: Annotated[
        str | None,
        typer.Option(
            help="How inputs move between steps.", show_default="the scenario's", metavar="NAME"
        ),
    ] = None,
    fmu_log: Annotated[
        Path | None,
        typer.Option(help="Keep what the FMUs log.", metavar="FILE", show_default=False),
    ] = None,
) -> None:
    """Run all variants of a scenario: summary, trajectories and figures."""
    given = {"stop_time": stop_time, "step": step, "tolerance": tolerance, "coupling": coupling}
    given = {key: value for key, value in given.items() if value is not None}
    found = _load(scenario, strict=strict, experiment=given)
    if fmu_log is not None:
        check_file("--fmu-log", fmu_log)
        fmu_log.parent.mkdir(parents=True, exist_ok=True)
        fmu_log.write_text("", encoding="utf-8")
    folder = result_folder(found, out)
    plan = plan_study(
        found,
        folder,
        swept=False,
        verify=verify,
        trust=trust is Bars.BARS or (False if trust is None else trust.value),
        timeout=timeout,
        fmu_log=fmu_log,
    )
    results = _carried_out(plan, Local(workers), progress)
    records = results.study().records
    if as_json:
        print_json([record.row() for record in records])
    else:
        print_summary(results)
        for record in records:
            for line in (record.coupling_why, record.trust_line):
                if line is not None:
                    print(f"{record.variant}: {line}")
        print_figures(results)
        _say_where(results)
    _warn_of_completed(records)
    complaints = [*_complaints(records)]
    for complaint in complaints:
        complain(complaint)
    if complaints:
        raise typer.Exit(FAILED)


def sweep(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml).", show_default=False)],
    out: Out = None,
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
    verify: Verify = False,
    timeout: Timeout = None,
    progress: ProgressForm = Form.BAR,
    as_json: Json = False,
    strict: Strict = False,
) -> None:
    """Run all variants at every point of the scenario's sweep, in worker processes."""
    if workers is not None and scheduler is not None:
        raise InvalidInput("give --workers or --scheduler, not both")
    if ship and scheduler is None:
        raise InvalidInput("--ship needs a --scheduler to send FMUs to; processes here have them")
    found = _load(scenario, strict=strict, swept=True)
    folder = result_folder(found, out)
    again = [as_status(status) for status in retry or ()]
    plan = plan_study(
        found,
        folder,
        swept=True,
        resume=bool(resume or dry_run or again),
        retry=again,
        verify=verify,
        timeout=timeout,
        write=not dry_run,
    )
    place = Local(workers or 1) if scheduler is None else Cluster(scheduler, ship=ship)
    if not as_json:
        _announce(plan, place, measured=dry_run or len(plan.missing) >= MEASURED)
    if dry_run:
        return
    results = _carried_out(plan, place, progress)
    if as_json:
        print_json([record.row() for record in results.runs])
    else:
        print_summary(results)
        _say_where(results)
    for name in without_effect(results.study()):
        complain(f"warning: {name} makes no difference: its values give the same metrics")
    _warn_of_completed(results.runs)
    if _complain_of_failures(results.runs):
        raise typer.Exit(FAILED)


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
    step: Annotated[
        float | None,
        typer.Option(
            help="Communication step for other tools, in s.", show_default="the experiment's"
        ),
    ] = None,
    native: Annotated[
        bool,
        typer.Option(
            "--native", help="Take the native FMUs, native/NAME.fmu beside those of the scenario."
        ),
    ] = False,
) -> None:
    """Write a scenario as a system that other tools can open: SSP 1.0 with the FMUs inside."""
    check_file("FILE", file)
    loaded = load_scenario(scenario)
    write_ssp(loaded, file, variant, derivatives=derivatives, step=step, native=native)
    chosen = next(one for one in loaded.variants if variant in (None, one.name))
    if step is None and loaded.case(chosen.settings).experiment.tolerance is not None:
        complain(
            "the archive states no step for other tools, as the scenario has a tolerance; --step "
            "gives one"
        )
    print(file)


def _load(
    file: Path,
    *,
    strict: bool,
    experiment: Mapping[str, object] | None = None,
    swept: bool = False,
) -> Scenario:
    """The scenario, after warnings of what may be a mistake in it, or in the points of its sweep.

    `experiment` has the keys of its experiment that options of the command give.

    Raises
    ------
    InvalidInput
        The first warning, if they are to be errors.
    """
    scenario = load_scenario(file, experiment or {})
    warnings = (*scenario.warnings, *scenario_warnings(scenario))
    warnings += sweep_warnings(scenario) if swept else ()
    if strict and warnings:
        raise InvalidInput(f"{warnings[0]} (--strict)")
    for warning in warnings:
        complain(f"warning: {warning}")
    return scenario


def _say_where(results: Results) -> None:
    """Print where the results are, and the command that shows them."""
    print(results.store.index)
    print(f"to look at them: congelation open {shlex.quote(str(results.folder))}")


def _carried_out(plan: Plan, workers: Workers, form: Form) -> Results:
    """Carry a study out and show how far it is."""
    if not available():
        complain(
            "the compiled stepping loop is not installed, so Python makes all steps: the same "
            "results, later; with a C compiler there, install congelation again"
        )
    try:
        with shown(plan, form) as listener:
            return carry_out(plan, workers, listener)
    except KeyboardInterrupt as error:
        done = plan.store.count(plan.job.study)
        remedy = "; go on with --resume" if plan.job.swept else ""
        complain(f"interrupted after {done} of {counted(plan.total, 'run')}{remedy}")
        raise typer.Exit(INTERRUPTED) from error
    except InvalidInput:
        _complain_of_failures(Results(plan.store.root, plan.job.study).runs)
        raise


def _announce(plan: Plan, workers: Workers, *, measured: bool) -> None:
    """Say how many runs there are, and what those missing will take."""
    print(f"{counted(plan.total, 'run')}, {len(plan.missing)} of them to do in {plan.store.root}")
    if plan.others:
        others = counted(plan.others, "other run")
        print(f"another study or an earlier state of the scenario has {others}")
    for version in plan.versions:
        if version != code_version():
            complain(
                f"warning: finished runs are of congelation {version}, this is {code_version()}; "
                "their numbers count as equal, as both have the same version of the numerics"
            )
    if not (measured and plan.missing):
        return
    try:
        print(estimate(plan, workers), flush=True)
    except InvalidInput:
        raise
    except CongelationError as error:
        print(f"no estimate: {error}", flush=True)


def _complain_of_failures(records: Iterable[RunRecord]) -> int:
    """Say how many runs failed, and how; returns how many."""
    kept = list(records)
    total, kinds = len(kept), Counter(record.status for record in kept if record.failed)
    failed = kinds.total()
    if failed:
        counts = ", ".join(f"{count} {status}" for status, count in kinds.most_common())
        complain(f"{failed} of {counted(total, 'run')} failed ({counts})")
        # Messages differ in their numbers: those that agree up to them have one cause.
        causes: dict[str, list[RunRecord]] = {}
        for record in kept:
            if record.failed:
                causes.setdefault(_NUMBER.sub("#", record.message), []).append(record)
        for same in sorted(causes.values(), key=len, reverse=True)[:MOST_CAUSES]:
            first = same[0]
            complain(f"{len(same)} x, such as run {first.run_id}: {first.message}")
    return failed


def _warn_of_completed(records: Iterable[RunRecord]) -> None:
    """What runs have to say beyond having reached their stop time, each kind once."""
    kinds: dict[str, list[RunRecord]] = {}
    for record in records:
        if record.remark:
            kinds.setdefault(_NUMBER.sub("#", record.remark), []).append(record)
    for same in sorted(kinds.values(), key=len, reverse=True)[:MOST_CAUSES]:
        others = f" (and {counted(len(same) - 1, 'other run')})" if len(same) > 1 else ""
        complain(f"warning: {same[0].variant}{others}: {same[0].remark}")


def _complaints(records: Iterable[RunRecord]) -> Iterator[str]:
    """What did not go as it should: failed runs, and runs too far from the reference."""
    for record in records:
        if record.failed:
            yield f"{record.variant}: {record.message}"
        for variable, relative in record.deviations.items():
            if relative > LARGEST_DEVIATION:
                yield (
                    f"{record.variant}: {variable} is off the monolithic solution by "
                    f"{relative:.1e} of its peak (at most {LARGEST_DEVIATION:g}); "
                    "give a smaller tolerance or, where the step is fixed, a shorter step"
                )
