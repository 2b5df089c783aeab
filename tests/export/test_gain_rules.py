"""The gain rules are in two tables, the host's and the FMUs': both have what models use.

That the rules of one name compute the same is tested in tests/theory/test_gains.py.
"""

from __future__ import annotations

import importlib

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


def test_fmus_know_the_rules_that_their_models_use(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(shipped("fmu_src"))
    inside = importlib.import_module("python.gains").RULES
    assert {form for form, _ in STRUCTURES} == set(FORMS)
    used = {
        gain.rule
        for form, structure in STRUCTURES
        for model in FORMS[form].models(structure)[:2]
        for gain in model.gains
    }
    assert set(inside) == used
    assert set(inside) <= set(RULES)
