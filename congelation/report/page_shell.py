"""What the HTML pages have in common: one self-contained file with its style, scripts and plots."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # Bokeh takes half a second, which only commands that write a page wait for
    from bokeh.models import Plot

__all__ = ["Drawn", "lines_of", "opening", "page", "pairs", "plain_page", "swatch", "table", "tile"]

_HEAD = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
{style}</style>
"""

_TEMPLATE = """{% from macros import embed %}
{{ head }}{{ bokeh_js }}
</head>
<body>
{% for piece in pieces %}{% if piece is string %}{{ piece }}
{% else %}<div class="plot" role="img" aria-label="{{ piece.alt | e }}">
{{- embed(roots[piece.name]) }}</div>
{% endif %}{% endfor %}
<script type="application/json" id="state">{{ state }}</script>
{% for script in scripts %}<script>
{{ script }}</script>
{% endfor %}{{ plot_script }}
</body>
</html>
"""


@dataclass(frozen=True)
class Drawn:
    """A place in a page where a plot goes; `alt` is its text alternative."""

    plot: Plot
    alt: str

    @property
    def name(self) -> str:
        return str(self.plot.name)


def page(
    title: str,
    pieces: Sequence[str | Drawn],
    state: Mapping[str, Any],
    scripts: Sequence[str] = ("report.js",),
) -> str:
    """A page with plots.

    Parameters
    ----------
    title : str
    pieces : sequence of str or Drawn
        HTML, and plots between it.
    state : mapping
        What the scripts read; numbers that are not finite become texts, as `finite` says.
    scripts : sequence of str
        Names of files in this package.
    """
    from bokeh.core.templates import get_env
    from bokeh.document import Document
    from bokeh.embed import file_html
    from bokeh.models import CustomJS
    from bokeh.resources import Resources

    if not any(isinstance(piece, Drawn) for piece in pieces):
        return plain_page(title, [piece for piece in pieces if isinstance(piece, str)])
    document = Document()
    for piece in pieces:
        if isinstance(piece, Drawn):
            document.add_root(piece.plot)
    document.js_on_event("document_ready", CustomJS(code="congelation.start(Bokeh.documents[0])"))
    text: str = file_html(
        document,
        Resources(mode="inline"),  # of it, what the plots use: no widgets, the controls are HTML's
        title,
        template=get_env().from_string(_TEMPLATE),
        template_variables={
            "head": _head(title),
            "pieces": pieces,
            # "</script>" in a text would end the element.
            "state": json.dumps(_json(state), allow_nan=False).replace("</", "<\\/"),
            "scripts": [_asset(name) for name in scripts],
        },
        suppress_callback_warning=True,
    )
    return text


def plain_page(title: str, pieces: Iterable[str]) -> str:
    """A page without plots or scripts."""
    return "\n".join([f"{_head(title)}</head>\n<body>", *pieces, "</body>\n</html>\n"])


def opening(title: str, verdict: Iterable[str]) -> Iterator[str]:
    """What a reader sees first: the title, and what there is to say in sentences."""
    yield '<a class="skip" href="#content">Skip to the content</a><main id="content">'
    yield f"<h1>{escape(title)}</h1>"
    yield '<div class="verdict">'
    for sentence in verdict:
        yield f"<p>{escape(sentence)}</p>"
    yield "</div>"


def tile(heading: str, shade: str, lines: Iterable[tuple[str, str]]) -> Iterator[str]:
    """A box of names and values under a heading, which is HTML; `shade` is a colour of CSS."""
    yield f'<section class="tile" style="border-color: {shade}"><h3>{heading}</h3><dl>'
    for name, value in lines:
        yield f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>"
    yield "</dl></section>"


def table(
    columns: Sequence[str],
    lines: Iterable[tuple[str, Sequence[str]]],
    caption: str = "",
    *,
    text: bool = False,
) -> Iterator[str]:
    """A table whose lines begin with a heading; it scrolls sideways in a narrow window.

    Its cells are numbers, or `text`, which is not set to the right.
    """
    kind = ' class="text"' if text else ""
    about = escape(caption or "table")
    yield f'<div class="scroll" tabindex="0" role="region" aria-label="{about}">'
    yield f"<table{kind}>{f'<caption>{escape(caption)}</caption>' if caption else ''}"
    heads = "".join(f'<th scope="col"{kind}>{escape(column)}</th>' for column in columns)
    yield f"<thead><tr><td></td>{heads}</tr></thead><tbody>"
    for label, cells in lines:
        entries = "".join(f"<td{kind}>{escape(cell)}</td>" for cell in cells)
        yield f'<tr><th scope="row">{escape(label)}</th>{entries}</tr>'
    yield "</tbody></table></div>"


def pairs(entries: Iterable[tuple[str, str]]) -> Iterator[str]:
    """A table of names and what they are."""
    yield '<table class="pairs">'
    for name, value in entries:
        yield f'<tr><th scope="row">{escape(name)}</th><td class="text">{escape(value)}</td></tr>'
    yield "</table>"


def swatch(variant: int, dash: Sequence[int] = ()) -> str:
    """A piece of a curve: the colour of a variant (-1: of what all share, -2: of the run that is
    picked) and a dash pattern."""
    shared = {-1: "var(--every)", -2: "var(--picked)"}
    shade = shared.get(variant, f"var(--v{variant % 8})")
    pattern = f' stroke-dasharray="{" ".join(map(str, dash))}"' if dash else ""
    return (
        '<svg class="swatch" viewBox="0 0 30 10" aria-hidden="true"><line x1="0" y1="5" x2="30" '
        f'y2="5" style="stroke: {shade}" stroke-width="3"{pattern}/></svg>'
    )


def lines_of(text: str) -> str:
    """A text as it is, in a box that scrolls."""
    return f'<pre tabindex="0">{escape(text)}</pre>'


def _head(title: str) -> str:
    return _HEAD.format(title=escape(title), style=_asset("report.css"))


def _asset(name: str) -> str:
    return files("congelation.report").joinpath(name).read_text("utf-8")


def _json(value: Any) -> Any:
    """`value` as JSON has it: nan as null, infinities as texts."""
    if isinstance(value, Mapping):
        return {str(key): _json(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_json(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return value
