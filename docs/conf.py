"""The documentation: `make docs` builds it into build/docs, with warnings as errors.

Pages are Markdown (MyST). Code cells of the tutorials are run by the build, which makes their
figures; the tables of the reference are written from the code by `generate.py`.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from generate import write_notebooks, write_reference  # noqa: E402  (beside this file)

project = "congelation"
author = "the authors of congelation"
copyright = author
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
]
highlight_language = "text"  # of code without a language: commands and what they print
html_theme = "furo"
html_title = "congelation"
html_extra_path = ["generated/files"]
html_show_sphinx = False
html_static_path = ["static"]
html_css_files = ["site.css"]

myst_enable_extensions = ["attrs_inline", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 4
myst_fence_as_directive = ["math"]

nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings say types in words and shapes
napoleon_numpy_docstring = True
napoleon_google_docstring = False
napoleon_use_ivar = True


html_math_renderer = "mathml"
LONG_FORMULA, LONG_CELL, SHORT_CELL, SHORT_CODE = 70, 60, 18, 24  # characters
MANY_COLUMNS = 6
FOLLOWING = (
    ["rule", "level", "section", "demand"],
    ["finding", "FMUs", "section", "the sentence, and the judgement"],
    ["equation", "formula", "function"],
)
LABELLED = ("default", "start", "unit", "FMUs")  # columns whose head a phone repeats in each cell


def formula(translator, node: nodes.math | nodes.math_block) -> None:  # type: ignore[no-untyped-def]
    """Write a formula as MathML, which browsers show without fetching anything."""
    if isinstance(node, nodes.math_block):
        whole = convert(node.astext(), display="block")
        translator.body.append(f'<div class="scrolls">{whole}</div>')
    else:
        inline = convert(node.astext())
        # One that is wider than a phone: a browser does not break formulas into lines.
        long = len(node.astext()) > LONG_FORMULA
        translator.body.append(f'<span class="scrolls">{inline}</span>' if long else inline)
    raise nodes.SkipNode


def widths(app: Sphinx, document: nodes.document, page: str) -> None:
    """Mark the cells of tables that need room, and what should not be broken: short cells and code.

    A browser makes the columns of a table as narrow as it can before it lets the table scroll, and
    ends a line after any hyphen, as after the two of an option.
    """
    for code in document.findall(nodes.literal):
        if len(code.astext()) <= SHORT_CODE:
            code["classes"].append("short")
    for table in document.findall(nodes.table):
        columns = next(table.findall(nodes.tgroup))["cols"]
        if columns >= MANY_COLUMNS:
            table["classes"].append("dense")
        head, *rows = table.findall(nodes.row)
        names = [name.astext() for name in head]
        described = page.startswith("generated/") and columns > 2 and "what it is" in names
        if described or names in FOLLOWING:
            labelled = LABELLED
        elif columns > 2 and any(
            len(cell.astext()) > LONG_CELL for cell in table.findall(nodes.entry)
        ):
            labelled = tuple(names[1:])
            table["classes"].append("cards")
        else:
            continue
        # On a phone, which has room for two columns, the cells of a row follow each other.
        table["classes"].append("stacked")
        for row in rows:
            for name, entry in zip(head, row, strict=True):
                head_text, text = name.astext(), entry.astext()
                if head_text and head_text in labelled and text not in ("", "required"):
                    title = [child.deepcopy() for child in name[0].children]
                    entry[0].insert(
                        0, nodes.inline("", "", *title, nodes.Text(": "), classes=["label"])
                    )
    for entry in document.findall(nodes.entry):
        size = len(entry.astext())
        if size > LONG_CELL:
            entry["classes"].append("long")
        elif size <= SHORT_CELL:
            entry["classes"].append("short")


def breaks(found: re.Match[str]) -> str:
    """A long name in code, which may be broken after each underscore."""
    return found[0].replace("_", "_<wbr>")


def block(found: re.Match[str]) -> str:
    """A block of code that a phone breaks before comments, and no window within options."""
    marked = re.sub(r"(?<=\s)--[a-z-]+", r'<span class="option">\g<0></span>', found[0])
    gap = r'(?<=\S)(?:  +|<span class="w">  +</span>)(?=#|<span class="c1">)'
    return re.sub(gap, r'<span class="gap">\g<0></span>', marked)


def options(app: Sphinx, page: str, template: str, context: dict, document: object) -> None:  # type: ignore[type-arg]
    """Say where a browser may break lines: not in options and numbers, after _ in long names."""
    if "body" not in context:  # a page without a text, such as the search
        return
    body = context["body"].replace('<span class="pre">-', '<span class="pre option">-')
    body = re.sub(rf'(?<=<span class="pre">)\w{{{SHORT_CODE + 1},}}(?=</span>)', breaks, body)
    body = re.sub(r"(?<=>)([A-Z]\w+)(Controller|Plant)(?=<)", r"\1<wbr>\2", body)
    body = re.sub(
        r"<math(?:(?!</math>).)*</math>[,.;:)]+", r'<span class="option">\g<0></span>', body
    )
    body = re.sub(
        r">[^<>]*-\d[^<>]*(?=<)",
        lambda text: re.sub(r"[\w.=]+-\d[\w.]*", r'<span class="option">\g<0></span>', text[0]),
        body,
    )
    context["body"] = re.sub(r"<pre>.*?</pre>", block, body, flags=re.DOTALL)


def setup(app: Sphinx) -> None:
    """Write the generated pages before Sphinx looks for pages."""
    app.add_html_math_renderer("mathml", (formula, None), (formula, None))
    app.connect("doctree-resolved", widths)
    app.connect("html-page-context", options)
    app.connect("config-inited", lambda app, config: write_reference(HERE / "generated"))
    app.connect("config-inited", lambda app, config: write_notebooks(HERE))
