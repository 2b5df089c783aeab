"""Every rule catches an FMU that breaks it, and lets a correct one pass."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import lag
import pytest
from archive_mutants import ARCHIVE_MUTANTS
from binary_mutants import BINARY_MUTANTS
from mutant import Edit, Mutant, exchanging, extra, swap
from xml_mutants import XML_MUTANTS

from congelation.conformance.checker import Checker
from congelation.conformance.finding import Verdict
from congelation.conformance.rule import BY_ID, Level, Outcome
from congelation.conformance.rules import RULES
from congelation.conformance.runner import check

MUTANTS = (*ARCHIVE_MUTANTS, *XML_MUTANTS, *BINARY_MUTANTS)
WORKERS = 2


def test_every_rule_has_a_mutant() -> None:
    assert {rule.id for rule in RULES} == {mutant.rule for mutant in MUTANTS}


def test_correct_fmu_passes_every_rule(
    correct: Path, library: Callable[[str], bytes], tmp_path: Path
) -> None:
    """As an FMU of both kinds; one rule is for those of co-simulation alone."""
    both = lag.build(tmp_path, library(""), edit=exchanging)
    (fmu,) = check([both]).fmus
    (alone,) = [v for v in fmu.verdicts if v.outcome is not Outcome.PASS]
    assert alone.rule.id == "FMI2-VARS-10"
    (verdict,) = check([correct], rules=["FMI2-VARS-10"]).fmus[0].verdicts
    assert verdict.outcome is Outcome.PASS


@pytest.fixture(scope="module")
def verdicts(
    request: pytest.FixtureRequest,
    library: Callable[[str], bytes],
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, Verdict]:
    """What the rules say of the mutants that are to be tested; two are checked at a time."""
    parameters = [getattr(i, "callspec", None) for i in request.session.items]
    asked = [p.params.get("mutant") for p in parameters if p is not None]
    chosen = [mutant for mutant in MUTANTS if mutant in asked]

    def judged(mutant: Mutant) -> Verdict:
        folder = tmp_path_factory.mktemp("mutant")
        entries = lag.read_entries(library(mutant.mutation))
        path = mutant.pack(folder, mutant.edit(entries))
        companion = None
        if mutant.companion is not None:
            companion = lag.write_archive(folder / "other.fmu", mutant.companion(entries))
        with Checker(path, companion, time_limit=mutant.time_limit) as checker:
            return checker.check(BY_ID[mutant.rule])

    with ThreadPoolExecutor(WORKERS) as pool:
        return dict(zip((m.label for m in chosen), pool.map(judged, chosen), strict=True))


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.label)
def test_mutant_is_caught(mutant: Mutant, verdicts: dict[str, Verdict]) -> None:
    verdict = verdicts[mutant.label]
    assert verdict.outcome is Outcome.FOUND, verdict.reason
    assert mutant.says in "\n".join(breach.what for breach in verdict.breaches)


def unchanged(entries: lag.Entries) -> lag.Entries:
    """The correct XML and archive."""
    return entries


# What is not always done so, and is correct: mutations, an edit, and the rules that look at it.
CORRECT: dict[str, tuple[str, Edit, tuple[str, ...]]] = {
    "with logAll every category is logged": (
        "",
        swap("<LogCategories>", '<LogCategories><Category name="logAll"/>'),
        ("FMI2-LOG",),
    ),
    "a vendor adds a platform": ("", extra("binaries/tux/model.bin"), ("FMI2-PACK",)),
    "the last successful time is told after fmi2Discard alone": (
        "status_after_discard_only",
        unchanged,
        ("FMI2-STATE", "FMI2-STEP-02"),
    ),
    "the FMU prints to standard output": (
        "prints_to_output",
        unchanged,
        ("FMI2-HOST", "FMI2-LIB", "FMI2-INST-06"),
    ),
    "other inputs make the initialization singular": (
        "input_must_rest",
        unchanged,
        ("FMI2-LIB", "FMI2-RESET", "FMI2-VALUE", "FMI2-STEP", "FMI2-FMUSTATE", "FMI2-STRUCT"),
    ),
    "zero has either sign": (
        "negative_zero",
        unchanged,
        ("FMI2-STEP-07", "FMI2-RESET", "FMI2-FMUSTATE", "FMI2-VALUE-01"),
    ),
    "the XML has fewer digits than the code": (
        "more_digits",
        swap('start="2.0"', 'start="0.666667"'),
        ("FMI2-VALUE-01", "FMI2-RESET"),
    ),
    "the functions of libm are left to the host": (
        "libm_left_to_host",
        unchanged,
        ("FMI2-LIB", "FMI2-HOST"),
    ),
}


@pytest.mark.parametrize("name", CORRECT)
def test_correct_variant_is_left_alone(
    name: str, library: Callable[[str], bytes], tmp_path: Path
) -> None:
    mutation, edit, rules = CORRECT[name]
    path = lag.build(tmp_path, library(mutation), edit=edit)
    report = check([path], rules=rules)
    assert [str(finding) for finding in report.findings] == []
    assert not any(v.outcome is Outcome.NOT_EVALUATED for v in report.fmus[0].verdicts)


def test_what_the_standard_leaves_open_is_no_violation(
    library: Callable[[str], bytes], tmp_path: Path
) -> None:
    date = swap("2024-01-01T00:00:00Z", "2024-01-01T00:00:00+01:00")
    path = lag.build(tmp_path, library("errors_need_logging"), edit=date)
    report = check([path], rules=["FMI2-LOG", "FMI2-XML-04"])
    assert [(f.rule, f.level) for f in report.findings] == [
        ("FMI2-XML-04", Level.WARNING),
        ("FMI2-LOG-06", Level.ROBUSTNESS),
    ]
    assert report.failures() == ()
