"""Every rule catches an FMU that breaks it, and lets a correct one pass."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import lag
import pytest
from archive_mutants import ARCHIVE_MUTANTS
from binary_mutants import BINARY_MUTANTS
from mutant import Mutant
from xml_mutants import XML_MUTANTS

from congelation.conformance.rule import Outcome
from congelation.conformance.rules import BY_ID, RULES
from congelation.conformance.runner import Checker, run

MUTANTS = (*ARCHIVE_MUTANTS, *XML_MUTANTS, *BINARY_MUTANTS)


def test_every_rule_has_a_mutant() -> None:
    assert {rule.id for rule in RULES} == {mutant.rule for mutant in MUTANTS}


def test_correct_fmu_passes_every_rule(correct: Path) -> None:
    (fmu,) = run([correct]).fmus
    assert [f"{f.rule.id}: {f.lines}" for f in fmu.findings if f.outcome is not Outcome.PASS] == []


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.label)
def test_mutant_is_caught(mutant: Mutant, library: Callable[[str], bytes], tmp_path: Path) -> None:
    entries = lag.read_entries(library(mutant.mutation))
    path = mutant.pack(tmp_path, mutant.edit(entries))
    companion = None
    if mutant.companion is not None:
        companion = lag.write_archive(tmp_path / "other.fmu", mutant.companion(entries))
    with Checker(path, companion, time_limit=mutant.time_limit) as checker:
        finding = checker.check(BY_ID[mutant.rule])
    assert finding.outcome is Outcome.VIOLATION
    assert mutant.says in "\n".join(finding.lines)
