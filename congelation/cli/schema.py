"""The command `schema`: what may stand in scenario and spec files, for editors."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from congelation.keys import SCENARIO, SPEC, json_schema

__all__ = ["schema"]


class Kind(StrEnum):
    """The kinds of files that have a schema."""

    SCENARIO = "scenario"
    SPEC = "spec"


def schema(
    kind: Annotated[Kind, typer.Argument(help="Which file.", show_default=False)],
) -> None:
    """Write the JSON Schema of scenario or spec files to stdout: keys, types, units, ranges."""
    table = {Kind.SCENARIO: SCENARIO, Kind.SPEC: SPEC}[kind]
    print(json_schema(table, f"congelation {kind}"), end="")
