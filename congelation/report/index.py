"""One page that links the reports and figures of several result directories.

python -m congelation.report.index results      writes results/index.html
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from html import escape, unescape
from pathlib import Path
from urllib.parse import quote

from congelation.errors import InvalidInput
from congelation.places import write_whole
from congelation.report.page_shell import plain_page

__all__ = ["write_index"]


def write_index(folder: Path) -> Path:
    """Write ``index.html`` into a folder of result directories.

    Raises
    ------
    InvalidInput
        There is no result directory in it.
    """
    found = sorted(runs.parent for runs in folder.glob("*/runs.parquet"))
    if not found:
        raise InvalidInput(f"{folder}: no result directory in it; `congelation run` makes one")
    file = folder / "index.html"
    write_whole(file, plain_page("Results", _page(folder, found)))
    return file


def _page(folder: Path, directories: list[Path]) -> Iterator[str]:
    yield "<main><h1>Results</h1>"
    for directory in directories:
        # Links are relative, so that the folder can be moved or sent as a whole.
        base = directory.relative_to(folder)
        report = directory / "report.html"
        title, said = directory.name, None
        if report.is_file():
            text = report.read_text("utf-8")
            head = re.search(r"<title>(.*?)</title>", text, re.DOTALL)
            title = unescape(head[1]) if head else title
            # Its verdict is what there is to say of it.
            said = re.search(r'<div class="verdict">(.*?)</div>', text, re.DOTALL)
        yield f"<h2>{escape(title)}</h2>\n{said[1] if said else ''}<p>"
        for name, shown in (("report.html", "Report"), ("runs.parquet", "runs.parquet, all rows")):
            if (directory / name).is_file():
                yield f'<a href="{quote((base / name).as_posix())}">{shown}</a> '
        yield '</p><p class="thumbs">'
        for figure in sorted((directory / "figures").glob("*.png")):
            link = quote((base / "figures" / figure.name).as_posix())
            alt = escape(figure.stem, quote=True)
            yield f'<a href="{link}"><img src="{link}" alt="{alt}" title="{alt}"></a>'
        yield "</p>"
    yield "</main>"


if __name__ == "__main__":
    print(write_index(Path(sys.argv[1])))
