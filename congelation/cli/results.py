"""Commands on result directories: `report`, `open`, `ls`, `show`, `export`."""

from __future__ import annotations

import re
import webbrowser
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from congelation.cli.shared import (
    as_status,
    complain,
    print_figures,
    print_json,
    print_summary,
    print_table,
)
from congelation.cosim.result import Status
from congelation.errors import InvalidInput, counted
from congelation.places import check_file, check_folder
from congelation.report.comparison import (
    BY_VARIANT,
    FEW,
    changes_by_run,
    changes_by_variant,
    verdict,
)
from congelation.report.comparison_page import write_comparison
from congelation.report.export_formats import write_csv, write_mat
from congelation.report.pareto import draw_front, pareto_front
from congelation.report.run_page import require_runs, write_html
from congelation.report.summary import metric_value, number, summarise_groups
from congelation.report.text_table import aligned
from congelation.results.print_figures import FORMATS, save
from congelation.results.record import GROUPS
from congelation.results.results import Results, open_results
from congelation.sweep.plan import FAILURES

__all__ = ["export", "ls", "open", "report", "show"]

Directory = Annotated[
    Path, typer.Argument(metavar="DIR", help="Result directory.", show_default=False)
]

SMALLEST, LARGEST = 2.0, 40.0  # inches: axes fit into the first, a poster is the second

PAGE, COMPARISON = "report.html", "comparison.html"
"""Names of the pages in a result directory; a comparison is in the last one that it compares."""

Directories = Annotated[
    list[Path],
    typer.Argument(
        metavar="DIR...",
        help="Result directory; of several, each is compared with the first.",
        show_default=False,
    ),
]

Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def report(
    folders: Directories,
    html: Annotated[
        Path | None,
        typer.Option(
            help="File to write the report to, one self-contained page.",
            metavar="FILE",
            show_default="DIR/report.html; of a comparison, comparison.html in the last DIR",
        ),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(help="Folder for the figures.", metavar="FOLDER", show_default="DIR/figures"),
    ] = None,
    form: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            help="pdf, png or svg (repeatable).",
            metavar="FORMAT",
            show_default="pdf and png",
        ),
    ] = None,
    width: Annotated[
        str, typer.Option(help="Width of the figures: in, cm or mm.", metavar="LENGTH")
    ] = "3.5in",
    by: Annotated[
        list[str] | None,
        typer.Option(help="Group runs by this column (repeatable).", show_default=False),
    ] = None,
    pareto: Annotated[
        list[str] | None,
        typer.Option(
            help="List the runs that no other beats in these metrics (repeatable), less is better.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Summarise a result directory, draw its figures and write its page, or compare several."""
    if len(folders) > 1:
        for option, value in (
            ("--figures", figures), ("--format", form), ("--by", by), ("--pareto", pareto),
        ):  # fmt: skip
            if value:
                raise InvalidInput(f"{option} is for one result directory; give DIR alone")
        _compare(folders, html)
        return
    (folder,) = folders
    results = open_results(folder)
    for option, names in (("--by", by or ()), ("--pareto", pareto or ())):
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise InvalidInput(f"{option} {twice} is given twice")
    _complain_of_lost(results)
    study = results.study()
    require_runs(results, study)
    formats = form or ["pdf", "png"]
    for name in formats:
        if name not in FORMATS:
            raise InvalidInput(f"--format {name}: give one of {', '.join(FORMATS)}")
    inches = _inches(width)
    if html is not None:
        check_file("--html", html)
    if figures is not None:
        check_folder("--figures", figures)
    if by:
        summary = summarise_groups(study, by)
        header = [", ".join(by), *summary.columns]
        print(aligned(header, [[label, *cells] for label, cells in summary.lines]))
    if pareto:
        front = pareto_front(study, pareto)
        if not front:
            raise InvalidInput(f"{folder}: no run has finite {' and '.join(pareto)}")
        _print_rows([run.row() for run in front], study.about["metrics"])
        if len(pareto) == 2:
            place = figures or folder / "figures"
            for file in save(draw_front(study, pareto), place, "pareto", formats):
                print(file)
    if not (by or pareto):
        print_summary(results)
    print_figures(results, figures, formats, inches)
    # Questions on the command line alone are answered there; a page of 10,000 runs takes seconds.
    if html is not None or not (by or pareto):
        page = html or folder / PAGE
        write_html(results, page)
        print(page)


def _compare(folders: Sequence[Path], html: Path | None) -> None:
    """Print what differs between result directories, and write the page of it."""
    if html is not None:
        check_file("--html", html)
    page = html or folders[-1] / COMPARISON
    for found in write_comparison([open_results(folder) for folder in folders], page):
        if len(found.pairs) <= FEW:
            columns, lines = [*found.names, "difference", "change"], changes_by_run(found)
        else:
            columns, lines = [*BY_VARIANT], changes_by_variant(found)
        print_table(f"{found.names[1]} against {found.names[0]}", columns, [*lines])
        for sentence in verdict(found):
            print(sentence)
        for label, name in found.alone[:FEW]:
            complain(f"{label}: only in {name}, or there more than once")
        if len(found.alone) > FEW:
            complain(f"and {counted(len(found.alone) - FEW, 'more run')}, which the page lists")
    print(page)


def open(folders: Directories) -> None:
    """Write the page of a result directory, or of a comparison, and show it in a browser."""
    page = (folders[-1] / (PAGE if len(folders) == 1 else COMPARISON)).absolute()
    if len(folders) == 1:
        write_html(open_results(folders[0]), page)
    else:
        write_comparison([open_results(folder) for folder in folders], page)
    print(page)
    if not webbrowser.open(page.as_uri()):
        complain(f"there is no browser to show it in; open {page} in one")


def ls(
    folder: Directory,
    status: Annotated[
        str | None, typer.Option(help="Only runs that ended so.", show_default="all")
    ] = None,
    as_json: Json = False,
) -> None:
    """List the runs of a result directory, also while a study writes into it."""
    wanted = None if status is None else as_status(status)
    known = (Status.COMPLETED.name, Status.TERMINATED.name, *FAILURES)
    if wanted is not None and wanted not in known:
        raise InvalidInput(f"'{status}' is no status; valid: {', '.join(known)}")
    results = open_results(folder)
    rows = [r for r in results.runs.rows() if wanted in (None, r["status"])]
    if as_json:
        print_json(rows)
    else:
        _print_rows(rows, results.about["metrics"])


def show(
    folder: Directory,
    run_id: Annotated[
        str,
        typer.Argument(
            metavar="RUN_ID", help="Id of a run, or its first digits.", show_default=False
        ),
    ],
    as_json: Json = False,
) -> None:
    """Show one run: everything in its record, and where its trajectory is."""
    results = open_results(folder)
    whole = results.store.find(run_id)
    row = next(row for row in results.runs.rows() if row["run_id"] == whole)
    file = results.store.trajectory_file(whole)
    row = {name: value for name, value in row.items() if value is not None or as_json}
    row["trajectory"] = str(file) if file.is_file() else None
    if as_json:
        print_json(row)
        return
    metrics = results.about["metrics"]
    lines = [(name, _cell(name, value, metrics)) for name, value in row.items()]
    print(aligned(lines[0], lines[1:]))


def export(
    folder: Directory,
    csv: Annotated[
        Path | None, typer.Option(help="Write runs and trajectories as CSV.", metavar="FOLDER")
    ] = None,
    mat: Annotated[
        Path | None, typer.Option(help="Write everything into one MAT-file.", metavar="FILE")
    ] = None,
) -> None:
    """Write a result directory for other programs: runs.parquet anew, CSV or a MAT-file."""
    results = open_results(folder)
    _complain_of_lost(results)
    if csv is None and mat is None:
        print(results.store.export())
    if csv is not None:
        check_folder("--csv", csv)
    if mat is not None:
        check_file("--mat", mat)
    if csv is not None:
        files = write_csv(results, csv)
        print(f"{counted(len(files), 'file')} in {csv}")
    if mat is not None:
        write_mat(results, mat)
        print(mat)


def _complain_of_lost(results: Results) -> None:
    """Say which trajectories are missing that were kept."""
    if lost := results.lost_trajectories():
        named = ", ".join(lost[:FEW]) + (", .." if len(lost) > FEW else "")
        complain(
            f"warning: {counted(len(lost), 'run')} of {results.folder} without the trajectory that "
            f"was kept: {named}; do them again with `congelation run`, or sweep --resume"
        )


def _inches(text: str) -> float:
    """A length as `--width` takes it, in inches."""
    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*(in|cm|mm)", text.strip())
    inches = float(match[1]) / {"in": 1.0, "cm": 2.54, "mm": 25.4}[match[2]] if match else 0.0
    if not SMALLEST <= inches <= LARGEST:
        raise InvalidInput(
            f"--width {text}: give a length from {SMALLEST:g}in to {LARGEST:g}in, such as 3.5in, "
            "8.8cm or 88mm"
        )
    return inches


def _cell(name: str, value: Any, metrics: Mapping[str, Any]) -> str:
    """A value of a column."""
    metric = name.removeprefix(GROUPS["metrics"])
    return metric_value(value, metrics[metric]) if metric in metrics else number(value)


def _print_rows(rows: Sequence[Mapping[str, object]], metrics: Mapping[str, Any]) -> None:
    """One line per run: what it is, how it ended, its settings and metrics."""
    if not rows:
        print("no runs")
        return
    names = dict.fromkeys(name for row in rows for name, value in row.items() if value is not None)
    # Of several studies, such as an earlier state of the scenario, each run names its own.
    several = len({row["study"] for row in rows}) > 1
    first = [
        name
        for name in ("run_id", "study", "variant", "replicate")
        if name in names and (several or name != "study")
    ]
    columns = first + [n for n in names if n.startswith("set.")] + ["status"]
    columns += [name for name in rows[0] if name.startswith("metric.")]
    header = [name.removeprefix("set.").removeprefix("metric.") for name in columns]
    print(aligned(header, [[_cell(n, row[n], metrics) for n in columns] for row in rows]))
