"""What the commands share: exit codes, complaints, the summary of a result directory."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from congelation.report.summary import summarise
from congelation.results.figures import save
from congelation.results.results import Results

__all__ = [
    "BAD_INPUT",
    "FAILED",
    "INTERRUPTED",
    "as_status",
    "complain",
    "print_figures",
    "print_json",
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


def print_summary(results: Results) -> None:
    """The summary of the newest study of a result directory."""
    study = results.study()
    summary = summarise(study)
    print_table(study.about["title"], summary.columns, summary.lines)


def print_figures(results: Results) -> None:
    """Draw the figures of a result directory, and say where they are."""
    for name in results.figures():
        for file in save(results.plot(name), results.folder / "figures", name):
            print(file)


def print_json(value: object) -> None:
    """`value` as JSON, with nan as null and infinities as text."""
    print(json.dumps(_plain(value), ensure_ascii=False, allow_nan=False))


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value
