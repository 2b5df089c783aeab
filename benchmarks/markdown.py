"""Numbers and tables in Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.timing import Timing

__all__ = ["Row", "duration", "microseconds", "power", "spread", "table", "verdict"]

Row = Sequence[str]


def table(head: Row, rows: Sequence[Row]) -> list[str]:
    """Lines of a table."""
    lines = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(line) + " |" for line in lines]


def verdict(is_met: bool) -> str:
    """Of a goal."""
    return "met" if is_met else "**missed**"


def power(target: float) -> str:
    """1e-6 rather than 1e-06."""
    mantissa, _, exponent = f"{target:.0e}".partition("e")
    return f"{mantissa}e{int(exponent)}"


def microseconds(time: Timing) -> str:
    """Median, least and most, without their unit."""
    return f"{time.median * 1e6:.1f} ({time.least * 1e6:.1f} – {time.most * 1e6:.1f})"


def spread(time: Timing) -> str:
    """Median, least and most."""
    return f"{duration(time.median)} ({duration(time.least)} – {duration(time.most)})"


def duration(seconds: float) -> str:
    """In a fitting unit."""
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"
