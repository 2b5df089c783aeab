"""Scenario files: TOML or SSP in, a checked `Scenario` out."""

from __future__ import annotations

from pathlib import Path

from congelation.errors import InvalidInput
from congelation.scenario.scenario import Scenario
from congelation.scenario.ssp.read import read_ssp
from congelation.toml import read_document

__all__ = ["load_scenario"]


def load_scenario(file: Path | str) -> Scenario:
    """Read a scenario: a TOML file, or an SSP archive (.ssp).

    Raises
    ------
    InvalidInput
        Naming the file, the path of the key, and what would be valid.

    Examples
    --------
    >>> cg.load_scenario("scenarios/fig2.toml").title
    'Fig. 2: state feedback'
    """
    path = Path(file)
    if path.suffix == ".ssp":
        return read_ssp(path)
    text, document = read_document(path)
    if "form" in document.data and "components" not in document.data:
        raise InvalidInput(
            f"{path}: this is a spec, from which FMUs are built (congelation build {path}); "
            "give a scenario"
        )
    return Scenario.from_document(document, path, text)
