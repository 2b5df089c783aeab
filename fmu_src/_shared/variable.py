"""One row of an FMU's table of variables; its place in the table is its value reference."""

from __future__ import annotations

from collections import namedtuple

__all__ = ["Variable"]

Variable = namedtuple("Variable", "name type causality variability initial start description")
