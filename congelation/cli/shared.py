"""What the commands share: exit codes, complaints, the summary of a result directory."""

from __future__ import annotations

import dataclasses
import enum
import functools
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from congelation.errors import one_line
from congelation.report.summary import summarise
from congelation.report.verdict import reading_aids
from congelation.results.print_figures import WIDTH, save
from congelation.results.results import Results

__all__ = [
    "BAD_INPUT",
    "EXIT_CODES",
    "FAILED",
    "INTERRUPTED",
    "UNREAD",
    "VIOLATED",
    "as_status",
    "complain",
    "interruptible",
    "print_figures",
    "print_json",
    "print_summary",
    "print_table",
]

DONE, FAILED, BAD_INPUT, VIOLATED, INTERRUPTED, UNREAD = 0, 1, 2, 3, 130, 141

EXIT_CODES: Mapping[int, str] = {
    DONE: "done",
    FAILED: "a run failed, or a check found something",
    BAD_INPUT: "the input or the usage is wrong",
    VIOLATED: "a certificate is violated, or an assumption of its theorem is broken",
    INTERRUPTED: "interrupted",
    UNREAD: "nobody reads the output any more, as behind `| head`",
}
"""What the exit codes mean: the same for every command."""

P = ParamSpec("P")
R = TypeVar("R")

# Characters that the labels and one column of a table are expected to take.
LABEL_WIDTH, COLUMN_WIDTH = 28, 16


def complain(text: str) -> None:
    """One line on stderr."""
    with suppress(BrokenPipeError):  # nobody reads it; the exit code says enough
        print(f"congelation: {one_line(text)}", file=sys.stderr)


def interruptible(
    command: Callable[P, R], ready: Callable[[], None] = lambda: None
) -> Callable[P, R]:
    """A command that ends with a line and the exit code of its own when it is interrupted.

    `ready` is called before it: from then on an interruption is a KeyboardInterrupt.
    """

    @functools.wraps(command)
    def wrapped(*arguments: P.args, **options: P.kwargs) -> R:
        try:
            ready()
            return command(*arguments, **options)
        except KeyboardInterrupt as error:
            complain(
                "interrupted: each file that is there is whole; give the command again for the rest"
            )
            raise typer.Exit(INTERRUPTED) from error

    return wrapped


def print_json(value: object) -> None:
    """A dataclass, or what JSON has, as JSON on stdout: nan as null, infinities as text."""
    print(json.dumps(_plain(value), indent=1, ensure_ascii=False, allow_nan=False))


def _plain(value: Any) -> object:
    """`value` in what JSON has."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return {field.name: _plain(getattr(value, field.name)) for field in fields}
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)  # JSON has neither
    return value


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
    for line in reading_aids(study):
        print(line)


def print_figures(
    results: Results,
    folder: Path | None = None,
    formats: Sequence[str] = ("pdf", "png"),
    width: float = WIDTH,
) -> None:
    """Draw the figures of a result directory, and say where they are."""
    for name in results.figures():
        for file in save(
            results.plot(name, width), folder or results.folder / "figures", name, formats
        ):
            print(file)
