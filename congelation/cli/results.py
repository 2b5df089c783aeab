"""Commands on result directories: `report`, `ls`, `show`, `export`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from congelation.cli.shared import as_status, print_figures, print_summary
from congelation.cosim.result import Status
from congelation.errors import InvalidInput
from congelation.places import check_file, check_folder
from congelation.report.exchange import write_csv, write_mat
from congelation.report.figures import save
from congelation.report.html import write_html
from congelation.report.pareto import draw_front, pareto_front
from congelation.report.summary import number, summarise_groups
from congelation.report.table import aligned
from congelation.results.records import metrics_of, settings_of
from congelation.results.store import Store
from congelation.sweep.sweep_plan import FAILURES

__all__ = ["export", "ls", "report", "show"]

Directory = Annotated[
    Path, typer.Argument(metavar="DIR", help="Result directory.", show_default=False)
]


def report(
    folder: Directory,
    html: Annotated[
        Path | None, typer.Option(help="Also write one self-contained HTML file.", metavar="FILE")
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
    """Summarise a result directory and draw its figures, from stored results alone."""
    store = _store(folder)
    if html is not None:
        check_file("--html", html)
    if by:
        summary = summarise_groups(store.read(), by)
        header = [", ".join(by), *summary.columns]
        print(aligned(header, [[label, *cells] for label, cells in summary.lines]))
    if pareto:
        front = pareto_front(store.read(), pareto)
        if not front:
            raise InvalidInput(f"{folder}: no run has finite {' and '.join(pareto)}")
        _print_rows(front)
        if len(pareto) == 2:
            for file in save(draw_front(store.read(), pareto), store.root / "figures", "pareto"):
                print(file)
    if not (by or pareto):
        print_summary(store)
    print_figures(store)
    if html is not None:
        write_html(store, html)
        print(html)


def ls(
    folder: Directory,
    status: Annotated[
        str | None, typer.Option(help="Only runs that ended so.", show_default="all")
    ] = None,
) -> None:
    """List the runs of a result directory, also while a sweep writes into it."""
    wanted = None if status is None else as_status(status)
    known = (Status.COMPLETED.name, *FAILURES)
    if wanted is not None and wanted not in known:
        raise InvalidInput(f"'{status}' is no status; valid: {', '.join(known)}")
    _print_rows([row for row in _store(folder).rows() if wanted in (None, row["status"])])


def show(
    folder: Directory,
    run_id: Annotated[
        str, typer.Argument(metavar="RUN_ID", help="Or its first digits.", show_default=False)
    ],
) -> None:
    """Show one run: everything in its row, and where its trajectory is."""
    store = _store(folder)
    row = store.find(run_id)
    file = store.trajectory_file(row["run_id"])
    lines = [(name, number(value)) for name, value in row.items()]
    lines.append(("trajectory", str(file) if file.is_file() else "not kept"))
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
    """Write a result directory for other programs."""
    if csv is None and mat is None:
        raise InvalidInput("nothing to do: give --csv FOLDER or --mat FILE")
    store = _store(folder)
    if csv is not None:
        check_folder("--csv", csv)
    if mat is not None:
        check_file("--mat", mat)
    if csv is not None:
        files = write_csv(store, csv)
        print(f"{len(files)} files in {csv}")
    if mat is not None:
        write_mat(store, mat)
        print(mat)


def _store(folder: Path) -> Store:
    """The store in `folder`, which has to be a directory."""
    if folder.exists() and not folder.is_dir():
        raise InvalidInput(
            f"{folder} is a file, not a result directory; give the directory that "
            "`congelation run` or `sweep` wrote"
        )
    return Store(folder)


def _print_rows(rows: Sequence[Mapping[str, object]]) -> None:
    """One line per run: what it is, how it ended, its metrics."""
    if not rows:
        print("no runs")
        return
    columns = ["run_id", "variant", *settings_of(rows[0]), "status", *metrics_of(rows[0])]
    print(aligned(columns, [[number(row[name]) for name in columns] for row in rows]))
