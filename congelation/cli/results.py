"""Commands on result directories: `report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from congelation.cli.shared import print_figures, print_summary
from congelation.report.html import write_html
from congelation.study.store import Store

__all__ = ["report"]


def report(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Result directory.", show_default=False)
    ],
    html: Annotated[
        Path | None, typer.Option(help="Also write one self-contained HTML file.", metavar="FILE")
    ] = None,
) -> None:
    """Summarise a result directory and draw its figures, from stored results alone."""
    store = Store(folder)
    print_summary(store)
    print_figures(store)
    if html is not None:
        write_html(store, html)
        print(html)
