"""Commands on result directories: `report`, `open`, `ls`, `show`, `export`."""

from __future__ import annotations

import webbrowser
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from congelation.cli.shared import as_status, complain, print_figures, print_json, print_summary
from congelation.cosim.result import Status
from congelation.errors import InvalidInput
from congelation.places import check_file, check_folder
from congelation.report.exchange import write_csv, write_mat
from congelation.report.html import write_html
from congelation.report.pareto import draw_front, pareto_front
from congelation.report.summary import number, summarise_groups
from congelation.report.table import aligned
from congelation.results.figures import save
from congelation.results.results import open_results
from congelation.sweep.plan import FAILURES

__all__ = ["export", "ls", "open", "report", "show"]

Directory = Annotated[
    Path, typer.Argument(metavar="DIR", help="Result directory.", show_default=False)
]

PAGE = "report.html"
"""Name of the page in its result directory."""

Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def report(
    folder: Directory,
    html: Annotated[
        Path | None,
        typer.Option(
            help="Where to write the page, one self-contained HTML file.",
            metavar="FILE",
            show_default="DIR/report.html",
        ),
    ] = None,
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
    """Summarise a result directory, draw its figures and write its page from stored results."""
    results = open_results(folder)
    study = results.study()
    if html is not None:
        check_file("--html", html)
    if by:
        summary = summarise_groups(study, by)
        header = [", ".join(by), *summary.columns]
        print(aligned(header, [[label, *cells] for label, cells in summary.lines]))
    if pareto:
        front = pareto_front(study, pareto)
        if not front:
            raise InvalidInput(f"{folder}: no run has finite {' and '.join(pareto)}")
        _print_rows([run.row() for run in front])
        if len(pareto) == 2:
            for file in save(draw_front(study, pareto), folder / "figures", "pareto"):
                print(file)
    if not (by or pareto):
        print_summary(results)
    print_figures(results)
    # Questions on the command line alone are answered there; a page of 10,000 runs takes seconds.
    if html is not None or not (by or pareto):
        page = html or folder / PAGE
        write_html(results, page)
        print(page)


def open(folder: Directory) -> None:
    """Write the page of a result directory, DIR/report.html, and show it in a browser."""
    page = (folder / PAGE).absolute()
    write_html(open_results(folder), page)
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
    rows = [r for r in open_results(folder).runs.rows() if wanted in (None, r["status"])]
    if as_json:
        print_json(rows)
    else:
        _print_rows(rows)


def show(
    folder: Directory,
    run_id: Annotated[
        str, typer.Argument(metavar="RUN_ID", help="Or its first digits.", show_default=False)
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
    lines = [(name, number(value)) for name, value in row.items()]
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
    if csv is None and mat is None:
        print(results.store.export())
    if csv is not None:
        check_folder("--csv", csv)
    if mat is not None:
        check_file("--mat", mat)
    if csv is not None:
        files = write_csv(results, csv)
        print(f"{len(files)} files in {csv}")
    if mat is not None:
        write_mat(results, mat)
        print(mat)


def _print_rows(rows: Sequence[Mapping[str, object]]) -> None:
    """One line per run: what it is, how it ended, its settings and metrics."""
    if not rows:
        print("no runs")
        return
    names = dict.fromkeys(name for row in rows for name, value in row.items() if value is not None)
    first = [name for name in ("run_id", "variant", "replicate") if name in names]
    columns = first + [n for n in names if n.startswith("set.")] + ["status"]
    columns += [name for name in rows[0] if name.startswith("metric.")]
    header = [name.removeprefix("set.").removeprefix("metric.") for name in columns]
    print(aligned(header, [[number(row[name]) for name in columns] for row in rows]))
