"""Tables as plain text that can be piped on: nothing wrapped, nothing cut off."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["aligned"]


def aligned(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Lines of text, columns padded to the width of their widest cell and two blanks apart."""
    table = [header, *lines]
    widths = [max(len(cell) for cell in column) for column in zip(*table, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in table
    )
