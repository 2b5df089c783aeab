"""What the commands share: exit codes, complaints, the summary of a result directory."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from congelation.report.figures import draw, figure_names, save
from congelation.report.summary import summarise
from congelation.results.store import Store

__all__ = [
    "BAD_INPUT",
    "FAILED",
    "INTERRUPTED",
    "as_status",
    "complain",
    "print_figures",
    "print_summary",
    "print_table",
]

FAILED, BAD_INPUT, INTERRUPTED = 1, 2, 130

# Characters that the labels and one column of a table are expected to take.
LABEL_WIDTH, COLUMN_WIDTH = 28, 16


def complain(text: str) -> None:
    """One line on stderr."""
    print(f"congelation: {' '.join(text.split())}", file=sys.stderr)


def as_status(text: str) -> str:
    """The name of a status as the command line may write it: timed-out, TIMED_OUT."""
    return text.upper().replace("-", "_")


def print_table(
    title: str, columns: Sequence[str], lines: Sequence[tuple[str, Sequence[str]]]
) -> None:
    """A table with a label at the head of each line, in as many parts as the terminal asks for."""
    console = Console()
    count = max(1, (console.width - LABEL_WIDTH) // COLUMN_WIDTH)
    for first in range(0, len(columns), count):
        part = slice(first, first + count)
        table = Table(title=escape(title) if first == 0 else None, title_justify="left")
        table.add_column("")
        for column in columns[part]:
            table.add_column(escape(column), justify="right")
        for label, cells in lines:
            table.add_row(escape(label), *(escape(cell) for cell in cells[part]))
        console.print(table)


def print_summary(store: Store) -> None:
    """The summary of a result directory."""
    study = store.read()
    summary = summarise(study)
    print_table(study.about["title"], summary.columns, summary.lines)


def print_figures(store: Store) -> None:
    """Draw the figures of a result directory, and say where they are."""
    for name in figure_names(store):
        for file in save(draw(store, name), store.root / "figures", name):
            print(file)
