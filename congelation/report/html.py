"""One self-contained HTML file of a study: summary, figures and provenance; no network."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from congelation.cosim.result import Status
from congelation.report.figures import draw, figure_names
from congelation.report.summary import Summary, metric_definitions, summarise
from congelation.results.records import Study
from congelation.results.store import Store, replace_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["write_html"]

_RESOLUTION = 200  # dots per inch: sharp on screens at twice the nominal size

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 60rem; margin: 2rem auto;
       padding: 0 1rem; }
table { border-collapse: collapse; margin: 1rem 0; }
th, td { padding: 0.25rem 0.75rem; border-bottom: 1px solid #ddd; text-align: right; }
th:first-child, td:first-child { text-align: left; }
td { font-variant-numeric: tabular-nums; }
td.text { text-align: left; overflow-wrap: anywhere; }
figure { margin: 1.5rem 0; }
img { width: 26rem; max-width: 100%; height: auto; }
pre { background: #f6f6f6; padding: 1rem; overflow-x: auto; font-size: 0.85rem; }
.failed { border-left: 4px solid #D55E00; padding-left: 0.75rem; }
"""


def write_html(store: Store, file: Path) -> None:
    """Write the report of a result directory.

    Raises
    ------
    InvalidInput
        If the directory holds no results.
    CongelationError
        If the file cannot be written.
    """
    study = store.read()
    figures = [(name, _png(draw(store, name))) for name in figure_names(store)]
    page = "\n".join(_page(study, figures))
    replace_whole(file, lambda temporary: temporary.write_text(page, encoding="utf-8"))


def _page(study: Study, figures: Sequence[tuple[str, bytes]]) -> Iterator[str]:
    title = escape(study.about["title"])
    yield '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f"<title>{title}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>"
    for row in study.rows:
        if row["status"] != Status.COMPLETED.name:
            yield f'<p class="failed">{escape(str(row["variant"]))}: {escape(row["message"])}</p>'
    yield "<h2>Summary</h2>"
    yield from _table(summarise(study))
    yield "<h2>Figures</h2>"
    for name, image in figures:
        data = base64.b64encode(image).decode()
        about = escape(f"{name}: the recorded variables of all runs against time")
        yield f'<figure><img alt="{about}" src="data:image/png;base64,{data}">'
        yield f"<figcaption>{escape(name)}</figcaption></figure>"
    yield "<h2>Metrics</h2>"
    yield from _pairs(metric_definitions(study))
    yield "<h2>Provenance</h2>"
    yield from _pairs(study.about["versions"].items())
    yield "<h3>FMUs</h3>"
    yield from _pairs(
        (f"{name}: {fmu['file']}", f"sha256 {fmu['sha256']}")
        for name, fmu in study.about["fmus"].items()
    )
    yield "<h3>Runs</h3>"
    yield from _pairs((str(row["variant"]), row["run_id"]) for row in study.rows)
    yield f"<h3>Scenario: {escape(study.about['scenario_file'])}</h3>"
    yield f"<pre>{escape(study.about['scenario'])}</pre>\n</body>\n</html>"


def _table(summary: Summary) -> Iterator[str]:
    heads = "".join(f'<th scope="col">{escape(column)}</th>' for column in summary.columns)
    yield f'<table>\n<tr><th scope="col"></th>{heads}</tr>'
    for label, cells in summary.lines:
        numbers = "".join(f"<td>{escape(cell)}</td>" for cell in cells)
        yield f'<tr><th scope="row">{escape(label)}</th>{numbers}</tr>'
    yield "</table>"


def _pairs(pairs: Iterable[tuple[str, str]]) -> Iterator[str]:
    yield "<table>"
    for name, value in pairs:
        yield f'<tr><th scope="row">{escape(name)}</th><td class="text">{escape(value)}</td></tr>'
    yield "</table>"


def _png(figure: Figure) -> bytes:
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=_RESOLUTION, metadata={"Software": None})
    return stream.getvalue()
