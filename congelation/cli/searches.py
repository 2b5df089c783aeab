"""Commands that search: `attack`, `tune`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

from congelation.cli.shared import FAILED, INTERRUPTED, VIOLATED, complain, print_table
from congelation.design.attack import OBJECTIVES
from congelation.design.attack import attack as search
from congelation.design.attack_fmus import attack_fmus as search_fmus
from congelation.design.finds import Attack, Find
from congelation.design.found_scenario import write_finds
from congelation.design.late_strike import SETTLED
from congelation.design.tune import Proposal, Tuning, write_proposals
from congelation.design.tune import tune as search_gains
from congelation.errors import InvalidInput
from congelation.export.spec import read_spec
from congelation.places import check_folder, name_of
from congelation.report.summary import NOT_SETTLED
from congelation.scenario.load import load_scenario

__all__ = ["attack", "tune"]

MEANT = {
    "peak": "peak = max |x|",
    "ise": "ise = int |x|^2 dt",
    "late": "late = max |x| once it had settled",
}
"""What the objectives are that every scenario has."""

NO_HIGHER = 1.02
"""A peak up to this times |x(0)| is that of the start."""


def attack(
    scenario: Annotated[Path, typer.Argument(help="Scenario (.toml).", show_default=False)],
    objective: Annotated[
        list[str] | None,
        typer.Option(
            help="What to maximise: peak, ise or late (|x| after it had settled), or a metric of "
            "the scenario (repeatable).",
            show_default="peak, ise, late",
        ),
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            help="Vary this free input or parameter of any FMU between its bounds, instead of "
            "theta(t) (repeatable).",
            metavar="COMPONENT.VARIABLE=LOW..HIGH",
            show_default=False,
        ),
    ] = None,
    variant: Annotated[
        list[str] | None, typer.Option(help="Only this variant (repeatable).", show_default="all")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the finds, which are scenarios.",
            metavar="DIR",
            show_default="results/<scenario>_attack",
        ),
    ] = None,
    effort: Annotated[
        float,
        typer.Option(
            min=0.01, help="Length of the search; 1 is half a minute per variant and objective."
        ),
    ] = 1.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random starts.")] = 0,
    workers: Annotated[int, typer.Option(min=1, help="Number of processes.")] = 1,
) -> None:
    """Search for the theta(t) that does most harm; exit code 3 if it breaks a certificate."""
    folder = out if out is not None else Path("results") / f"{name_of(scenario)}_attack"
    check_folder("--out", folder)
    found = _with_progress(scenario, objective, vary, variant, effort, seed, workers)
    files = write_finds(found, folder)
    print_table(
        f"{found.scenario.title}: the worst theta(t) found (lower bounds on the worst case)",
        ["value", "jumps", "margin", "|z|^2", "decay"],
        [(f"{find.variant}, {find.objective}", _cells(find)) for find in found.finds],
    )
    if any(find.bound is not None for find in found.finds):
        print(
            "|z|^2 <= 2 V(0) and decay = int sum c_i z_i^2 dt <= V(0): what the certificate bounds"
        )
    if legend := "; ".join(
        text for name, text in MEANT.items() if any(f.objective == name for f in found.finds)
    ):
        print(legend)
    for find in found.finds:
        if (line := _burst(find) or _none_higher(find)) is not None:
            print(line)
    for file in files:
        print(file)
    for line in found.notes:
        complain(f"warning: {line}")
    for line in found.missed:
        complain(line)
    for find in found.violated:
        complain(
            f"{find.variant}: {find.objective}: the certificate fails along the find: margin "
            f"{find.margin:.2e} of the terms of V'"
        )
    if found.violated:
        raise typer.Exit(VIOLATED)
    if found.missed:
        raise typer.Exit(FAILED)


def _with_progress(
    scenario: Path,
    objectives: list[str] | None,
    vary: list[str] | None,
    variants: list[str] | None,
    effort: float,
    seed: int,
    workers: int,
) -> Attack:
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
    loaded = load_scenario(scenario)  # what is wrong with it is said without a bar above
    with Progress(*columns, console=Console(stderr=True)) as bar:
        tasks: dict[tuple[str, str], object] = {}

        def show(variant: str, objective: str, done: float, best: float) -> None:
            task = (variant, objective)
            text = escape(f"{variant}, {objective}: {best:.4g}")
            if task not in tasks:
                tasks[task] = bar.add_task(text, total=1.0)
            bar.update(tasks[task], completed=done, description=text)  # type: ignore[arg-type]

        more: dict[str, Any] = {
            "variants": variants,
            "effort": effort,
            "seed": seed,
            "progress": show,
        }
        if vary:
            bounds = dict(map(_bounds, vary))
            return search_fmus(loaded, bounds, objectives=objectives or (), **more)
        return search(loaded, objectives=objectives or OBJECTIVES, workers=workers, **more)


def _bounds(text: str) -> tuple[str, tuple[float, float]]:
    """``component.variable=low..high``, read."""
    name, _, bounds = text.partition("=")
    low, _, high = bounds.partition("..")
    try:
        return name.strip(), (float(low), float(high))
    except ValueError:
        raise InvalidInput(
            f"--vary {text}: write it as component.variable=LOW..HIGH, e.g. plant.dtheta[1]=-1..1"
        ) from None


def _cells(find: Find) -> list[str]:
    line = [
        f"{find.value:.4g}",
        str(len(find.cells.theta) - 1),
        "" if math.isnan(find.margin) else f"{find.margin:.1e}",
    ]
    if find.bound is None:
        return [*line, "no bound", "no bound"]
    bound = find.bound
    energy = f"{2 * bound.energy:.4g} <= {2 * bound.V0:.4g}"
    return [*line, energy, f"{bound.decay:.4g} <= {bound.V0:.4g}"]


def _none_higher(find: Find) -> str | None:
    """One line on a peak that is the start."""
    if find.objective != "peak" or not find.value <= NO_HIGHER * find.initial:
        return None
    return (
        f"{find.variant}: no theta(t) found that takes |x| far above where it starts, "
        f"{find.initial:.4g}"
    )


def _burst(find: Find) -> str | None:
    """One line on a late find."""
    if find.struck is None or find.growth is None:
        return None
    if find.value <= SETTLED or find.growth <= 0.0:
        return (
            f"{find.variant}: no burst found once |x| had settled below {SETTLED:g} (largest "
            f"|x| from then on {find.value:.4g})"
        )
    return (
        f"{find.variant}: settled, struck at {find.struck:.4g} s, bursts to {find.value:.4g} "
        f"(with the estimates frozen the loop grows at {find.growth:.3g} 1/s)"
    )


def tune(
    spec: Annotated[Path, typer.Argument(help="Spec (.toml).", show_default=False)],
    settling: Annotated[
        float | None,
        typer.Option(help="Wish: largest time, in seconds, after which |x| has settled."),
    ] = None,
    effort: Annotated[float | None, typer.Option(help="Wish: largest int u^2 dt.")] = None,
    peak_input: Annotated[float | None, typer.Option(help="Wish: largest max |u|.")] = None,
    below: Annotated[
        float, typer.Option(help="Bound on |x| below which it counts as settled.")
    ] = 1e-2,
    stop_time: Annotated[
        float | None,
        typer.Option(
            help="End of the simulations in s.", show_default="20, or twice --settling if longer"
        ),
    ] = None,
    evaluations: Annotated[int, typer.Option(min=10, help="Designs to try.")] = 600,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search.")] = 0,
    workers: Annotated[int, typer.Option(min=1, help="Number of processes.")] = 1,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the designs that were tried and the proposals.",
            metavar="DIR",
            show_default="results/<spec>_tune",
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue with the designs in the folder.")
    ] = False,
) -> None:
    """Search for gains that meet a wish, or without one beat the spec's own; exit 1 if not met."""
    for name, number in (("--below", below), ("--stop-time", stop_time)):
        if number is not None and not number > 0.0:
            raise InvalidInput(f"{name} {number:g}; valid: a positive number")
    folder = out if out is not None else Path("results") / f"{name_of(spec)}_tune"
    check_folder("--out", folder)
    read_spec(spec)  # what is wrong with it is said without a bar above
    named = {"settling": settling, "effort": effort, "peak_input": peak_input}
    try:
        with Progress(
            TextColumn("{task.description}"), BarColumn(), console=Console(stderr=True)
        ) as bar:
            task = bar.add_task("designs tried", total=evaluations)
            found = search_gains(
                spec,
                wishes={name: value for name, value in named.items() if value is not None},
                below=below,
                stop_time=stop_time,
                evaluations=evaluations,
                seed=seed,
                workers=workers,
                out=folder,
                resume=resume,
                progress=lambda done, total: bar.update(task, completed=done, total=total),
            )
            bar.update(task, total=found.evaluations, completed=found.evaluations)
    except KeyboardInterrupt as error:
        complain("interrupted; go on with --resume")
        raise typer.Exit(INTERRUPTED) from error
    _print_tuning(found, write_proposals(found, folder))
    if found.unmet:
        for line in found.unmet:
            complain(line)
        raise typer.Exit(FAILED)


def _print_tuning(found: Tuning, files: list[Path]) -> None:
    rows = [(f"{found.spec.stem}, as it is", found.own)]
    rows += [(file.stem, proposal) for file, proposal in zip(files, found.front, strict=True)]
    print_table(
        f"{found.spec}: {found.evaluations} designs tried; the first after the spec's own is the "
        f"nearest to the wish; simulated to {found.stop_time:g} s",
        ["settling, s", "int u^2 dt", "max |u|", "certificate"],
        [
            (name, [*_numbers(p.objectives), "holds" if p.certified else "violated"])
            for name, p in rows
        ],
    )
    for file, proposal in zip(files, found.front, strict=True):
        print(f"{file}: {_gains(proposal) or 'the gains of the spec'}")


def _numbers(objectives: Mapping[str, float]) -> list[str]:
    return [f"{v:.4g}" if v < math.inf else NOT_SETTLED for v in objectives.values()]


def _gains(proposal: Proposal) -> str:
    return ", ".join(
        f"{name} = {value.squeeze().tolist()}" for name, value in proposal.values.items()
    )
