"""The runner: hangs, obstacles, what does not apply, and how findings are reported."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import lag
import pytest
from mutant import XML, renamed, swap, without
from rich.console import Console

from congelation.conformance.binding import FUNCTIONS, Tape, filled
from congelation.conformance.checker import Checker
from congelation.conformance.description import Unreadable, default_initial, read_description
from congelation.conformance.finding import Report
from congelation.conformance.report import to_json, to_junit, to_lines, to_table
from congelation.conformance.rule import BY_ID, DynamicRule, Level, Outcome, StaticRule
from congelation.conformance.rules import RULES
from congelation.conformance.runner import check, select
from congelation.conformance.subject import Subject
from congelation.errors import InvalidInput

Library = Callable[[str], bytes]

DYNAMIC = tuple(rule for rule in RULES if isinstance(rule, DynamicRule))


def test_hang_is_a_finding(library: Library, tmp_path: Path) -> None:
    path = lag.build(tmp_path, library("hangs"))
    with Checker(path, time_limit=1.0) as checker:
        verdict = checker.check(BY_ID["FMI2-LIB-03"])
    assert verdict.outcome is Outcome.FOUND
    assert verdict.breaches[0].what == "not done after 1 s (in fmi2DoStep)"


def test_crash_names_signal_and_function(library: Library, tmp_path: Path) -> None:
    path = lag.build(tmp_path, library("null_freed"))
    with Checker(path) as checker:
        verdict = checker.check(BY_ID["FMI2-INST-03"])
    (breach,) = verdict.breaches
    assert breach.what == "the process was killed by SIGABRT in fmi2FreeInstance (a null pointer)"


@pytest.mark.parametrize(
    ("mutation", "rule"),
    [
        ("initialization_fails", "FMI2-LIB-03"),
        ("memory_function_used step_crashes", "FMI2-LIB-03"),
        ("library_missing", "FMI2-HOST-02"),
        ("instantiation_fails", "FMI2-LIB-03"),
        ("instantiated_once", "FMI2-INST-04"),
        ("unknown_reference_crashes", "FMI2-VALUE-05"),
        ("state_crashes", "FMI2-FLAG-01"),
    ],
)
def test_one_cause_is_one_finding(
    mutation: str, rule: str, library: Library, tmp_path: Path
) -> None:
    path = lag.build(tmp_path, library(mutation))
    rules = [
        *("FMI2-LIB-01", "FMI2-LIB-02", "FMI2-LIB-03", "FMI2-HOST", "FMI2-INST-04"),
        *(
            "FMI2-FLAG-01",
            "FMI2-FMUSTATE",
            "FMI2-VALUE-05",
            "FMI2-VALUE-06",
            "FMI2-LOG",
            "FMI2-RESET-01",
        ),
    ]
    report = check([path], rules=rules)
    assert [finding.rule for finding in report.findings] == [rule]
    verdicts = report.fmus[0].verdicts
    assert all(v.reason for v in verdicts if v.outcome is Outcome.NOT_EVALUATED)
    assert "Traceback" not in to_json(report)


def test_two_faults_of_one_call_are_two_findings(library: Library, tmp_path: Path) -> None:
    path = lag.build(tmp_path, library("parameter_survives_reset reset_refused"))
    report = check([path], rules=["FMI2-RESET-02", "FMI2-RESET-03"])
    assert [finding.rule for finding in report.findings] == ["FMI2-RESET-02", "FMI2-RESET-03"]


def test_finding_has_the_log_of_the_fmu(library: Library, tmp_path: Path) -> None:
    path = lag.build(tmp_path, library("instantiation_fails"))
    (finding,) = check([path], rules=["FMI2-LIB-03"]).findings
    assert "there is no licence" in finding.what
    assert any("there is no licence" in line for line in finding.evidence)


def test_log_messages_have_their_arguments(library: Library, tmp_path: Path) -> None:
    path = lag.build(tmp_path, library("arguments_logged logs_always"))
    (finding,) = check([path], rules=["FMI2-LOG-02"]).findings
    assert "'initialized at 0, 12 of lag, 0.5 and 7'" in finding.what


def test_filled_reads_only_what_is_there() -> None:
    assert filled("100 % done", ()) == "100 % done"
    registers = (3, *(0.25,) * 8, *(8,) * 8)
    assert filled("%d%% of %s at %.2f", registers) == "3% of <no string> at 0.25"


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
def test_obstacle_leaves_dynamic_rules_unevaluated(
    edit: Callable[[lag.Entries], lag.Entries], reason: str, library: Library, tmp_path: Path
) -> None:
    path = lag.build(tmp_path, library(""), edit=edit)
    with Checker(path) as checker:
        verdict = checker.check(BY_ID["FMI2-RESET-01"])
    assert verdict.outcome is Outcome.NOT_EVALUATED
    assert reason in verdict.reason
    assert "static rules only" in checker.scope


def test_file_that_is_no_archive(tmp_path: Path) -> None:
    path = tmp_path / "no.fmu"
    path.write_text("no archive")
    (fmu,) = check([path]).fmus
    assert [f.rule for f in fmu.findings] == ["FMI2-PACK-01", "FMI2-PACK-02"]
    assert all(v.outcome is Outcome.NOT_EVALUATED for v in fmu.verdicts if v.rule in DYNAMIC)


@pytest.mark.parametrize("version", ["1.0", "3.0"])
def test_other_versions_are_out_of_scope(version: str, library: Library, tmp_path: Path) -> None:
    path = lag.build(
        tmp_path, library(""), edit=swap('fmiVersion="2.0"', f'fmiVersion="{version}"')
    )
    (fmu,) = check([path]).fmus
    assert not fmu.in_scope
    assert fmu.scope == f"FMI {version}: not checked, the rules are those of FMI 2.0"
    assert fmu.findings == ()


def test_unpacked_fmu_is_checked(correct: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(correct) as archive:
        archive.extractall(tmp_path / "lag")
    report = check([tmp_path / "lag"], rules=["FMI2-PACK", "FMI2-XML", "FMI2-LIB"])
    assert report.findings == ()
    assert "(unpacked)" in report.fmus[0].scope
    assert report.fmus[0].count(Outcome.PASS) == 21


def test_schema_errors_of_files_checked_at_once_are_not_mixed(tmp_path: Path) -> None:
    rule = BY_ID["FMI2-XML-02"]
    assert isinstance(rule, StaticRule)
    look, names = rule.look, ["colour", "shape", "taste", "weight"] * 100

    def found(name: str) -> list[str]:
        xml = f'<fmiModelDescription fmiVersion="2.0" modelName="m" guid="g" {name}="red"/>'
        subject = Subject(tmp_path / "m.fmu", (), "", xml.encode())
        return [str(breach) for breach in look(subject) if name in str(breach)]

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(found, names))


def test_static_starts_no_process(
    library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(*arguments: object, **named: object) -> None:
        raise AssertionError("a process was started")

    monkeypatch.setattr("congelation.conformance.child_processes.subprocess.Popen", forbidden)
    path = lag.build(tmp_path, library(""), edit=swap(' start="0.25"', ""))
    (finding,) = check([path], static=True).findings
    assert (finding.rule, finding.file, finding.line) == ("FMI2-VARS-05", XML, 45)
    assert f"lag.fmu/{XML}:45: FMI2-VARS-05 violation: u has no start value - " in str(finding)


def test_known_findings_are_not_counted(library: Library, tmp_path: Path) -> None:
    path = lag.build(tmp_path, library("version_wrong"))
    known = tmp_path / "known.toml"
    entry = '[[known]]\nrule = "{}"\nfmu = "l*.fmu"\nreason = "old header"\n'
    known.write_text(entry.format("FMI2-LIB-02") + entry.format("FMI2-LIB-03"))
    report = check([path], rules=["FMI2-LIB"], known=known)
    assert report.failures(Level.ROBUSTNESS) == ()
    assert [finding.known for finding in report.findings] == ["old header"]
    assert report.unused == ("FMI2-LIB-03 in l*.fmu",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("known = 1", r"valid are entries \[\[known\]\]"),
        ('[[known]]\nrule = "FMI2-LIB-02"', "entry 1 of .* needs rule, fmu and reason"),
        ('[[known]]\nrule = "FMI2-LOB-02"\nfmu = "*"\nreason = "x"', "did you mean"),
        ('[[known]]\nrule = "FMI2-LIB-02"\nfmu = "*"\nreason = ""', "not empty"),
        ("[[known", "known.toml"),
    ],
)
def test_wrong_known_file_is_refused(
    text: str, message: str, correct: Path, tmp_path: Path
) -> None:
    known = tmp_path / "known.toml"
    known.write_text(text)
    with pytest.raises(InvalidInput, match=message):
        check([correct], known=known)


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
    (fmu,) = check([path]).fmus
    assert [str(finding) for finding in fmu.findings] == []
    families = {f.rule.id[:-3] for f in fmu.verdicts if f.outcome is Outcome.NOT_APPLICABLE}
    assert {"FMI2-FMUSTATE", "FMI2-SERIAL", "FMI2-FLAG"} <= families


def test_fmu_for_one_instance_has_no_violation(library: Library, tmp_path: Path) -> None:
    flag = swap("<CoSimulation", '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true"')
    path = lag.build(tmp_path, library("second_instance_refused"), edit=flag)
    (fmu,) = check([path]).fmus
    assert [str(finding) for finding in fmu.findings] == []


def test_two_fmus_are_checked_next_to_each_other(
    correct: Path, library: Library, tmp_path: Path
) -> None:
    other = lag.build(tmp_path, library("start_differs"), name="other.fmu")
    report = check([correct, other], rules=["FMI2-INST-06", "FMI2-VALUE-01"])
    outcomes = [[v.outcome for v in fmu.verdicts] for fmu in report.fmus]
    assert outcomes == [[Outcome.PASS, Outcome.PASS], [Outcome.PASS, Outcome.FOUND]]
    assert len(report.failures()) == 1


def test_select_takes_ids_and_families() -> None:
    assert [rule.id for rule in select(["FMI2-LIB-02"])] == ["FMI2-LIB-02"]
    family = select(["FMI2-RESET"])
    assert [rule.id for rule in family] == [f"FMI2-RESET-0{number}" for number in (1, 2, 3, 4)]
    with pytest.raises(
        InvalidInput, match="no rule is named 'FMI2-LIB-99': did you mean 'FMI2-LIB"
    ):
        select(["FMI2-LIB-99"])


def test_static_rules_alone_that_are_none_are_refused(correct: Path) -> None:
    with pytest.raises(InvalidInput, match="FMI2-STEP-01 runs the FMU"):
        check([correct], rules=["FMI2-STEP"], static=True)


def test_run_wants_files(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="there is no FMU at"):
        check([tmp_path / "missing.fmu"])


def test_folder_that_is_no_fmu_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"is no unpacked FMU: it has no modelDescription\.xml"):
        check([tmp_path])


def test_defect_of_a_rule_is_none_of_the_fmu(correct: Path) -> None:
    def broken(subject: Subject) -> Iterator[str]:
        raise ZeroDivisionError("division by zero")

    rule = BY_ID["FMI2-PACK-02"]
    assert isinstance(rule, StaticRule)
    with Checker(correct, static=True) as checker:
        verdict = checker.check(replace(rule, look=broken))
    assert verdict.outcome is Outcome.NOT_EVALUATED
    assert "the check itself failed (ZeroDivisionError: division by zero)" in verdict.reason


def test_rules_are_complete() -> None:
    for rule in RULES:
        assert re.fullmatch(r"FMI2-[A-Z]+-\d\d", rule.id)
        assert re.fullmatch(r"\d(\.\d)+([-,] ?\d(\.\d)+)*", rule.section)
        assert rule.sentence.endswith(".")
        assert all((rule.quote, rule.why, rule.remedy, rule.example))
        # What the standard demands or recommends is quoted.
        assert rule.level is Level.ROBUSTNESS or '"' in rule.quote or "standard" in rule.quote
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
    """A report with a warning, a violation, a rule that does not apply, and one that passed."""
    path = lag.build(
        tmp_path_factory.mktemp("mixed"),
        library("line_break_logged function_missing"),
        edit=without("model.png"),
    )
    return check([path], rules=["FMI2-LOG-07", "FMI2-PACK-12", "FMI2-LIB-01", "FMI2-LIB-02"])


def test_json_report(mixed: Report) -> None:
    data = json.loads(to_json(mixed))
    assert data["counts"] == {"violation": 1, "warning": 1, "robustness": 0}
    (fmu,) = data["fmus"]
    assert [(f["rule"], f["outcome"]) for f in fmu["rules"]] == [
        ("FMI2-PACK-12", "not applicable"),
        ("FMI2-LIB-01", "found"),
        ("FMI2-LIB-02", "pass"),
        ("FMI2-LOG-07", "found"),
    ]
    assert fmu["findings"][0]["what"] == "fmi2CancelStep is not exported"
    assert all(f["remedy"] and f["evidence"] and f["standard"] for f in fmu["findings"])


@pytest.mark.parametrize(
    ("fail_on", "failures"), [(Level.VIOLATION, 1), (Level.WARNING, 2), (Level.ROBUSTNESS, 2)]
)
def test_junit_report(mixed: Report, fail_on: Level, failures: int) -> None:
    (suite,) = ElementTree.fromstring(to_junit(mixed, fail_on))
    counts = [suite.get(name) for name in ("tests", "failures", "errors", "skipped")]
    assert counts == ["4", str(failures), "0", "1"]
    skipped, failed, passed, warned = suite
    assert [child.tag for child in skipped] == ["skipped"]
    assert list(passed) == []
    assert warned[0].tag == ("system-out" if failures == 1 else "failure")
    assert "fmi2CancelStep is not exported - " in failed[0].get("message", "")
    assert "section 2.3" in (failed[0].text or "")


def test_lines_and_table(mixed: Report) -> None:
    (fmu,) = mixed.fmus
    violation, warning, counts = to_lines(fmu)
    assert fmu.scope == "FMI 2.0 co-simulation, static rules and dynamic rules on linux64"
    assert "FMI2-LIB-01 violation: fmi2CancelStep is not exported - " in violation
    assert "FMI2-LOG-07 warning: " in warning
    assert "1 violation, 1 warning, 0 robustness, 1 pass, 0 known, 1 not applicable" in counts
    console = Console(width=120, force_terminal=False)
    with console.capture() as capture:
        console.print(to_table(fmu))
    assert "FMI2-LIB-02" in capture.get()
