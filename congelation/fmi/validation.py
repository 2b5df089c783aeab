"""The check of every built FMU: what `fmpy validate` looks at."""

from __future__ import annotations

from pathlib import Path

from fmpy.validation import validate_fmu

from congelation.errors import InvalidInput

__all__ = ["validate"]


def validate(path: Path) -> None:
    """Check an FMU's archive and model description against the FMI standard.

    Raises
    ------
    InvalidInput
        With every problem found.
    """
    problems = validate_fmu(str(path))
    if problems:
        raise InvalidInput(f"{path}: not a valid FMU: " + "; ".join(map(str, problems)))
