"""The runner: hangs, obstacles, what does not apply, and how findings are reported."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

import lag
import pytest
from mutant import XML, renamed, swap, without
from rich.console import Console

from congelation.conformance.binding import FUNCTIONS, Tape
from congelation.conformance.description import Unreadable, default_initial, read_description
from congelation.conformance.report import print_report, to_json, to_junit
from congelation.conformance.rule import Kind, Outcome
from congelation.conformance.rules import BY_ID, RULES
from congelation.conformance.runner import Checker, Report, run, select
from congelation.errors import InvalidInput

Library = Callable[[str], bytes]

DYNAMIC = tuple(rule for rule in RULES if rule.kind is Kind.DYNAMIC)


def test_hang_is_a_finding(library: Library, tmp_path: Path) -> None:
    path = lag.build(tmp_path, library("hangs"))
    with Checker(path, time_limit=1.0) as checker:
        finding = checker.check(BY_ID["FMI2-LIB-03"])
    assert finding.outcome is Outcome.VIOLATION
    assert finding.lines == ("not done after 1 s (in fmi2DoStep)",)


def test_crash_names_signal_and_function(library: Library, tmp_path: Path) -> None:
    path = lag.build(tmp_path, library("null_freed"))
    with Checker(path) as checker:
        finding = checker.check(BY_ID["FMI2-INST-03"])
    assert finding.lines == ("the process was killed by SIGABRT in fmi2FreeInstance",)


def test_broken_plain_run_is_one_finding(library: Library, tmp_path: Path) -> None:
    path = lag.build(tmp_path, library("initialization_fails"))
    rules = select(["FMI2-LIB-03", "FMI2-RESET", "FMI2-VALUE-02"])
    (fmu,) = run([path], rules=rules).fmus
    broken = [f.rule.id for f in fmu.findings if f.outcome is Outcome.VIOLATION]
    assert broken == ["FMI2-LIB-03"]
    assert fmu.count(Outcome.NOT_APPLICABLE) == len(rules) - 1


@pytest.mark.parametrize(
    ("edit", "reason"),
    [
        (without(XML), "there is no modelDescription.xml"),
        (lambda entries: {**entries, XML: b"<fmi"}, "not well-formed"),
        (lambda entries: {**entries, XML: b"<other/>"}, "the root element is <other>"),
        (
            renamed("binaries/linux64/lag.so", "binaries/win64/lag.dll"),
            "no binary for this platform",
        ),
        (
            lambda entries: {
                **entries,
                XML: re.sub(rb"<CoSimulation.*</CoSimulation>", b"", entries[XML], flags=re.DOTALL),
            },
            "no FMU for co-simulation",
        ),
    ],
)
def test_obstacle_makes_dynamic_rules_not_applicable(
    edit: Callable[[lag.Entries], lag.Entries], reason: str, library: Library, tmp_path: Path
) -> None:
    path = lag.build(tmp_path, library(""), edit=edit)
    with Checker(path) as checker:
        finding = checker.check(BY_ID["FMI2-RESET-01"])
    assert finding.outcome is Outcome.NOT_APPLICABLE
    assert reason in finding.lines[0]


def test_file_that_is_no_archive(tmp_path: Path) -> None:
    path = tmp_path / "no.fmu"
    path.write_text("no archive")
    (fmu,) = run([path]).fmus
    violations = [f.rule.id for f in fmu.findings if f.outcome is Outcome.VIOLATION]
    assert violations == ["FMI2-PACK-01", "FMI2-PACK-02"]
    assert all(f.outcome is Outcome.NOT_APPLICABLE for f in fmu.findings if f.rule in DYNAMIC)


def modest(entries: lag.Entries) -> lag.Entries:
    """The same model without any capability, default experiment, or structured names."""
    text = entries[XML].decode()
    for pattern in (
        r'\n    (can|max|provides)\w+="\w+"',
        r"<SourceFiles>.*</SourceFiles>",
        r"<DefaultExperiment[^>]*/>",
        r' (dependencies|dependenciesKind)="[^"]*"',
        r'generationDateAndTime="[^"]*"',
    ):
        text = re.sub(pattern, "", text)
    text = text.replace('"structured"', '"flat"').replace("table[1]", "table ä")
    kept = {
        name for name in entries if not name.startswith(("sources/", "documentation/", "model"))
    }
    return {**{name: entries[name] for name in kept}, XML: text.encode()}


def test_modest_fmu_has_no_violation(library: Library, tmp_path: Path) -> None:
    path = lag.build(tmp_path, library(""), edit=modest)
    (fmu,) = run([path]).fmus
    assert [(f.rule.id, f.lines) for f in fmu.findings if f.outcome is Outcome.VIOLATION] == []
    families = {f.rule.id[:-3] for f in fmu.findings if f.outcome is Outcome.NOT_APPLICABLE}
    assert {"FMI2-FMUSTATE", "FMI2-SERIAL", "FMI2-FLAG"} <= families


def test_fmu_for_one_instance_has_no_violation(library: Library, tmp_path: Path) -> None:
    flag = swap("<CoSimulation", '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true"')
    path = lag.build(tmp_path, library("second_instance_refused"), edit=flag)
    (fmu,) = run([path]).fmus
    assert [(f.rule.id, f.lines) for f in fmu.findings if f.outcome is Outcome.VIOLATION] == []


def test_two_fmus_are_checked_next_to_each_other(
    correct: Path, library: Library, tmp_path: Path
) -> None:
    other = lag.build(tmp_path, library("start_differs"), name="other.fmu")
    report = run([correct, other], rules=select(["FMI2-INST-06", "FMI2-VALUE-01"]))
    outcomes = [[f.outcome for f in fmu.findings] for fmu in report.fmus]
    assert outcomes == [[Outcome.PASS, Outcome.PASS], [Outcome.PASS, Outcome.VIOLATION]]
    assert report.violations == 1


def test_select_takes_ids_and_families() -> None:
    assert [rule.id for rule in select(["FMI2-LIB-02"])] == ["FMI2-LIB-02"]
    family = select(["FMI2-RESET"])
    assert [rule.id for rule in family] == ["FMI2-RESET-01", "FMI2-RESET-02", "FMI2-RESET-03"]
    with pytest.raises(
        InvalidInput, match="no rule is named 'FMI2-LIB-99': did you mean 'FMI2-LIB"
    ):
        select(["FMI2-LIB-99"])


def test_run_wants_files(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="there is no FMU at"):
        run([tmp_path / "missing.fmu"])


def test_rules_are_complete() -> None:
    for rule in RULES:
        assert re.fullmatch(r"FMI2-[A-Z]+-\d\d", rule.id)
        assert re.fullmatch(r"\d(\.\d)+([-,] ?\d(\.\d)+)*", rule.section)
        assert rule.sentence.endswith(".")
    assert len(BY_ID) == len(RULES)


def test_functions_are_those_of_the_headers() -> None:
    header = lag.header("fmi2Functions.h")
    exported = set(re.findall(r"FMI2_Export fmi2(\w+)TYPE\s+fmi2\w+;", header))
    exchange = {
        "EnterEventMode",
        "NewDiscreteStates",
        "EnterContinuousTimeMode",
        "CompletedIntegratorStep",
        "SetTime",
        "SetContinuousStates",
        "GetDerivatives",
        "GetEventIndicators",
        "GetContinuousStates",
        "GetNominalsOfContinuousStates",
    }
    assert set(FUNCTIONS) == exported - exchange


@pytest.mark.parametrize(
    ("causality", "variability", "initial"),
    [
        ("parameter", "fixed", "exact"),
        ("calculatedParameter", "tunable", "calculated"),
        ("input", "continuous", ""),
        ("output", "constant", "exact"),
        ("output", "discrete", "calculated"),
        ("local", "fixed", "calculated"),
        ("independent", "continuous", ""),
    ],
)
def test_default_initial(causality: str, variability: str, initial: str) -> None:
    assert default_initial(causality, variability) == initial


def test_number_that_is_none_is_unreadable() -> None:
    text = (lag.SOURCES / XML).read_text().replace('valueReference="0"', 'valueReference="zero"')
    with pytest.raises(Unreadable, match="zero"):
        read_description(text.encode())


def test_tape_outlives_its_writer(tmp_path: Path) -> None:
    tape = Tape(tmp_path / "tape")
    tape.write("fmi2DoStep")
    assert Tape.read(tmp_path / "tape") == "fmi2DoStep"
    tape.write("")
    assert Tape.read(tmp_path / "tape") == ""
    assert Tape.read(tmp_path / "none") == ""


@pytest.fixture(scope="module")
def mixed(library: Library, tmp_path_factory: pytest.TempPathFactory) -> Report:
    """A report with a violation, a rule that does not apply, and one that passed."""
    path = lag.build(
        tmp_path_factory.mktemp("mixed"), library("line_break_logged"), edit=without("model.png")
    )
    return run([path], rules=select(["FMI2-LOG-05", "FMI2-PACK-12", "FMI2-LIB-02"]))


def test_json_report(mixed: Report) -> None:
    data = json.loads(to_json(mixed))
    assert data["violations"] == 1
    (fmu,) = data["fmus"]
    assert [(f["rule"], f["outcome"]) for f in fmu["findings"]] == [
        ("FMI2-PACK-12", "not applicable"),
        ("FMI2-LIB-02", "pass"),
        ("FMI2-LOG-05", "violation"),
    ]
    assert fmu["counts"] == {"pass": 1, "violation": 1, "not applicable": 1, "known limit": 0}


def test_junit_report(mixed: Report) -> None:
    (suite,) = ElementTree.fromstring(to_junit(mixed))
    counts = [suite.get(name) for name in ("tests", "failures", "errors", "skipped")]
    assert counts == ["3", "1", "0", "1"]
    skipped, passed, failed = suite
    assert [child.tag for child in skipped] == ["skipped"]
    assert list(passed) == []
    (failure,) = failed
    assert "line break" in failure.get("message", "")
    assert "section 2.1.5" in (failure.text or "")


def test_table_shows_what_is_wrong(mixed: Report) -> None:
    console = Console(width=120, record=True, file=None, quiet=False, force_terminal=False)
    with console.capture() as capture:
        print_report(mixed, console)
    text = capture.get()
    assert "FMI2-LOG-05" in text
    assert "FMI2-LIB-02" not in text
    assert "1 pass, 1 violation, 1 not applicable, 0 known limit" in text
    with console.capture() as capture:
        print_report(mixed, console, everything=True)
    assert "FMI2-LIB-02" in capture.get()
