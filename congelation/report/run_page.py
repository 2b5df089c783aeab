"""The report of a result directory: one self-contained HTML file, without any request."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from congelation.errors import InvalidInput
from congelation.places import write_whole
from congelation.report.curves import POINTS, curve_panels
from congelation.report.diagram import diagram
from congelation.report.page_shell import Drawn, lines_of, opening, page, pairs, swatch, table, tile
from congelation.report.panels import controls, draw_panels
from congelation.report.study_page import study_content
from congelation.report.study_verdict import study_verdict
from congelation.report.summary import metric_definitions, summarise
from congelation.report.verdict import (
    LISTED,
    bursts,
    metric_of_kind,
    run_verdict,
    settled,
    settling_rule,
    tiles,
)
from congelation.results.record import RunRecord, Study, Trajectory
from congelation.results.results import Results

__all__ = ["draw_overlaid", "require_runs", "trajectory_of", "write_html"]

SHOWN = 8
"""Runs whose trajectories a page shows at once; there are colours for so many."""


def write_html(results: Results, file: Path) -> None:
    """Write the report of a result directory.

    Raises
    ------
    InvalidInput
        If the directory holds no results.
    CongelationError
        If the file cannot be written.
    """
    study = results.study()
    require_runs(results, study)
    text = _study_page(results, study) if study.about["swept"] else _run_page(results, study)
    write_whole(file, text)


def require_runs(results: Results, study: Study) -> None:
    """Refuse a study without runs, as one that was killed before its first run was kept.

    Raises
    ------
    InvalidInput
    """
    if not study.records:
        raise InvalidInput(
            f"{results.folder} has no runs; if a study began there, go on with: congelation sweep "
            "SCENARIO --resume"
        )


def _run_page(results: Results, study: Study) -> str:
    """The page of a scenario's variants, each run once."""
    kept = [
        (run, trajectory_of(results, study, run))
        for run in study.records
        if results.store.trajectory_file(run.run_id).is_file()
    ]
    variants = [run.variant for run in study.records]
    drawn = [(variants.index(run.variant), trajectory) for run, trajectory in kept]
    plots, scales = draw_overlaid(drawn, variants, [study])
    peaks = {run.run_id: peak for run, recorded in kept if (peak := _peak_u(recorded)) is not None}
    named = {f"the run of {run.variant}": recorded for run, recorded in kept[:SHOWN]}
    verdict = (*run_verdict(study, peaks), *bursts(study, named))
    pieces: list[str | Drawn] = [*_head(study, verdict), *_tiles(study, peaks)]
    pieces += plots
    pieces += system(study)
    pieces.append("<h2>Metrics</h2>")
    summary = summarise(study)
    pieces += table(summary.columns, summary.lines, "Settings, status and metrics of every run")
    pieces += _definitions(study)
    pieces += _verification(study)
    pieces += provenance(study)
    state = {"variants": variants, "scales": scales}
    return page(study.about["title"], [*pieces, "</main>"], state)


def trajectory_of(results: Results, study: Study, run: RunRecord) -> Trajectory:
    """The trajectory of a run, with what is known of theta(t)."""
    return replace(results.store.trajectory(run.run_id), signals=study.signals(run))


def draw_overlaid(
    runs: Sequence[tuple[int, Trajectory]], names: Sequence[str], studies: Sequence[Study]
) -> tuple[list[str | Drawn], dict[str, dict[str, Any]]]:
    """The section of trajectories: controls, and the plots of all runs over each other.

    Parameters
    ----------
    runs : sequence of (int, Trajectory)
        Each with the place of its name.
    names : sequence of str
        What the curves are called.
    studies : sequence of Study
        That the runs are of; norms in their figures have panels, too.

    Returns
    -------
    pieces : list
    scales : dict
        Of the plots, for the page's script.
    """
    # Of more runs than there are colours the first are drawn, and the page says so.
    norms = [p for s in studies for f in s.about["figures"] for p in f["panels"] if p[:1] == "|"]
    panels = curve_panels(runs[:SHOWN], tuple(dict.fromkeys(norms)))
    plots, scales = draw_panels(panels, names)
    pieces: list[str | Drawn] = ["<h2>Trajectories</h2>"]
    if not plots:
        return [*pieces, '<p class="note">No trajectories were kept.</p>'], scales
    # A curve without a finite value has no points.
    times = [c.time for panel in panels for c in panel.curves if len(c.time)]
    start = min((float(t[0]) for t in times), default=0.0)
    stop = max((float(t[-1]) for t in times), default=start)
    pieces += controls(names[:SHOWN], start, stop)
    pieces += _thinned([recorded for _, recorded in runs])
    if len(runs) > SHOWN:
        pieces.append(
            f'<p class="note">The first {SHOWN} of {len(runs)} runs are drawn; the others are '
            "in the tables.</p>"
        )
    return [*pieces, *plots], scales


def _study_page(results: Results, study: Study) -> str:
    content, scales, data = study_content(results, study)
    pieces = [
        *_head(study, (*study_verdict(study), *bursts(study, _latest(results, study)))),
        *content,
        *_definitions(study),
        *system(study),
        *provenance(study),
        "</main>",
    ]
    variants = list(dict.fromkeys(run.variant for run in study.records))
    state = {"variants": variants, "scales": scales, "study": data}
    return page(study.about["title"], pieces, state, ("report.js", "study.js"))


def _latest(results: Results, study: Study) -> dict[str, Trajectory]:
    """Of each variant the run that settles last, which tells what delays it, if it was kept."""
    name = metric_of_kind(study, "settling_time")
    variants = dict.fromkeys(run.variant for run in study.records)
    if name is None or len(variants) > LISTED:
        return {}
    found = {}
    for variant in variants:
        runs = [r for r in study.records if r.variant == variant and settled(study, r)]
        last = max(runs, key=lambda run: run.metrics[name] or 0.0, default=None)
        if last is not None and results.store.trajectory_file(last.run_id).is_file():
            which = " that settles last" if len(runs) > 1 else ""
            found[f"the run of {variant}{which}"] = results.store.trajectory(last.run_id)
    return found


def _head(study: Study, verdict: Iterable[str]) -> Iterator[str]:
    """Title, verdict and failures: what a reader sees first."""
    yield from opening(study.about["title"], verdict)
    if rule := settling_rule(study):
        yield f'<p class="note">{escape(rule)}</p>'
    for run in study.records[: 0 if study.about["swept"] else None]:
        if run.failed:
            yield f'<p class="failed">{escape(run.variant)}: {escape(run.message)}</p>'
        elif run.remark:
            yield f'<p class="note">{escape(run.variant)}: {escape(run.remark)}</p>'


def _tiles(study: Study, peaks: dict[str, float]) -> Iterator[str]:
    yield '<div class="tiles">'
    for k, (variant, lines) in enumerate(tiles(study, peaks)):
        yield from tile(f"{swatch(k)} {escape(variant)}", f"var(--v{k % 8})", lines)
    yield "</div>"


def _peak_u(trajectory: Trajectory) -> float | None:
    r"""The peak of \|u\| of a recorded run."""
    columns = [c for c in trajectory.columns if c.rpartition(".")[2].partition("[")[0] == "u"]
    if not columns or not len(trajectory.time):
        return None
    return float(np.max(np.linalg.norm(trajectory.select(columns), axis=1)))


def _thinned(trajectories: Sequence[Trajectory]) -> Iterator[str]:
    longest = max(len(trajectory.time) for trajectory in trajectories)
    if longest > POINTS:
        yield (
            f'<p class="note">Curves have up to {longest} stored points; {POINTS} are drawn: '
            f"the least and the largest of each of {POINTS // 2} stretches. Start, least, "
            "largest and end are of all points; the value at the cursor is of the drawn ones.</p>"
        )


def system(study: Study) -> Iterator[str]:
    """The system as a diagram, if its connections were stored."""
    drawing = [*diagram(study.about)]
    if drawing:
        yield "<h2>System</h2>"
        yield from drawing


def _definitions(study: Study) -> Iterator[str]:
    definitions = metric_definitions(study)
    if definitions:
        yield "<details><summary>What the metrics are</summary>"
        yield from pairs(definitions)
        yield "</details>"


def _verification(study: Study) -> Iterator[str]:
    """What is known of the numerical error of each run, folded."""
    yield "<details><summary>Verification</summary>"
    lines = [*_verified(study.records)]
    if not lines:
        asked = " or ".join(f"<code>{name}</code>" for name in ("--verify", "--trust"))
        yield f"<p>No run was compared with another solution; {asked} does that.</p>"
    else:
        yield from table([run.variant for run in study.records], lines, "Errors and margins")
    yield "</details>"


def _verified(runs: Sequence[RunRecord]) -> Iterator[tuple[str, list[str]]]:
    def line(label: str, values: Sequence[float | None]) -> Iterator[tuple[str, list[str]]]:
        if any(value is not None for value in values):
            yield label, ["–" if value is None else f"{value:.2e}" for value in values]

    yield from line("estimated error of the coupling", [run.estimated_error for run in runs])
    yield from line("estimated error, by a second run", [run.trust_error for run in runs])
    yield from line("worst margin of the certificate", [run.worst_margin for run in runs])
    for name in dict.fromkeys(name for run in runs for name in run.deviations):
        label = f"error of {name} against the monolithic solution / peak"
        yield from line(label, [run.deviations.get(name) for run in runs])


def provenance(study: Study) -> Iterator[str]:
    """Where the numbers come from, folded."""
    yield "<details><summary>Provenance</summary><h3>Versions</h3>"
    yield from pairs(study.about["versions"].items())
    yield "<h3>FMUs</h3>"
    yield from pairs(
        (f"{name}: {fmu['file']}", f"sha256 {fmu['sha256']}")
        for name, fmu in study.about["fmus"].items()
    )
    if not study.about["swept"]:
        yield "<h3>Runs</h3>"
        yield from pairs((run.variant, run.run_id) for run in study.records)
    yield f"<h3>Scenario: {escape(study.about['scenario_file'])}</h3>"
    yield lines_of(study.about["scenario"])
    yield "</details>"
