"""Scenario files: TOML or SSP in, a checked `Scenario` out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from congelation.arguments import checked
from congelation.errors import InvalidInput
from congelation.scenario.parts import EXPERIMENT, replaced
from congelation.scenario.scenario import Scenario
from congelation.scenario.ssp.read import read_ssp
from congelation.toml import read_document

__all__ = ["load_scenario"]


@checked
def load_scenario(file: Path | str, experiment: Mapping[str, object] | None = None) -> Scenario:
    """Read a scenario: a TOML file, or an SSP archive (.ssp).

    Parameters
    ----------
    file : path
    experiment : mapping, optional
        Keys of its experiment that replace those of the file: stop_time, step, .. A step replaces
        a tolerance and the other way round, unless both are given; a coupling replaces the options
        as well.

    Raises
    ------
    InvalidInput
        Naming the file, the path of the key, and what would be valid.

    Examples
    --------
    >>> cg.load_scenario("scenarios/fig2.toml").title
    'Fig. 2: state feedback'
    """
    path, given = Path(file), dict(experiment or {})
    if path.suffix == ".ssp":
        return _with_given(read_ssp(path, given), given)
    text, document = read_document(path)
    if "form" in document.data and "components" not in document.data:
        raise InvalidInput(
            f"{path}: this is a spec, from which FMUs are built (congelation build {path}); "
            "give a scenario"
        )
    table = document.data.get(EXPERIMENT, {})
    if given and isinstance(table, Mapping):
        data = {**document.data, EXPERIMENT: replaced(table, given)}
        document = replace(document, data=data)
    return _with_given(Scenario.from_document(document, path, text), given)


def _with_given(scenario: Scenario, given: Mapping[str, object]) -> Scenario:
    """The scenario, which knows what was given, unless a variant changes such a key, too."""
    for key in given:
        for variant in scenario.variants:
            if f"{EXPERIMENT}.{key}" in variant.settings:
                raise InvalidInput(
                    f"{scenario.place}: {EXPERIMENT}.{key} is what the variant '{variant.name}' "
                    "sets; change it in the file"
                )
    return scenario.changed(given=tuple(given))
