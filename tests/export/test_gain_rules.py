"""The gain rules are in two tables, the host's and the FMUs': they name and compute the same."""

from __future__ import annotations

import importlib
import math
import sys
import types
from collections.abc import Callable, Iterator, Mapping

import numpy as np
import pytest

from congelation.export.forms import FILTERS, FORMS
from congelation.places import shipped
from congelation.theory.gains import RULES

# One structure of each form, for every filter that a spec can choose.
STRUCTURES = [
    ("scalar", {}),
    ("matched", {"A": [[0.0, 1.0], [0.0, 0.0]], "B": [0.0, 1.0]}),
    ("strict-feedback", {"phibar": [[[-1.0], [0.0]], [[0.0], [1.0]]]}),
    *(("observer", {"n": 3, "m": 1, "filter": name}) for name in FILTERS),
]

# Values of the parameters, and the constants, of each rule.
ARGUMENTS: dict[str, tuple[list[object], dict[str, object]]] = {
    "filter_norm": ([[3.0, 3.5, 2.0]], {}),
    "hurwitz_filter_gain": ([[3.0, 3.5, 2.0]], {}),
    "iss_filter_gain": ([6.0, 0.4], {"n": 3}),
    "matched_riccati": (
        [2.0, 1.0, 0.7, True, [[1.0, 0.2], [0.2, 2.0]]],
        {"A": ((0.0, 1.0), (0.5, -0.3)), "B": ((0.0,), (1.0,))},
    ),
}


@pytest.fixture(scope="module")
def fmu_rules() -> Iterator[Mapping[str, Callable[..., list[float]]]]:
    """The table inside of every FMU, loaded as a package of its own."""
    package = types.ModuleType("fmu_runtime")
    package.__path__ = [str(shipped("fmu_src") / "python")]
    sys.modules["fmu_runtime"] = package
    yield importlib.import_module("fmu_runtime.gains").RULES
    for name in [name for name in sys.modules if name.startswith("fmu_runtime")]:
        del sys.modules[name]


def test_fmus_know_the_rules_that_their_models_use(fmu_rules) -> None:
    used = {
        gain.rule
        for form, structure in STRUCTURES
        for model in FORMS[form].models(structure)[:2]
        for gain in model.gains
    }
    assert set(fmu_rules) == used
    assert set(fmu_rules) <= set(RULES)


@pytest.mark.parametrize("name", ARGUMENTS)
def test_both_compute_the_same(fmu_rules, name: str) -> None:
    arguments, constants = ARGUMENTS[name]
    inside = fmu_rules[name](*arguments, **constants)
    outside = RULES[name](*(np.asarray(a) for a in arguments), **constants)
    assert all(math.isfinite(value) for value in inside)
    # The norm is bisected for, on whether an equation has a solution. Near the norm rounding
    # decides that, and its error enters by a square root: half of the digits.
    assert inside == pytest.approx(np.asarray(outside).ravel().tolist(), rel=1e-6)


def test_every_rule_is_compared(fmu_rules) -> None:
    assert set(ARGUMENTS) == set(fmu_rules)
