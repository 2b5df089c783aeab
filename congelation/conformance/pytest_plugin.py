"""pytest --fmu PATH: every rule of FMI 2.0 as a test case, for each FMU given.

A violation fails, and a finding of another level if asked for; a rule that does not look is
skipped; an accepted finding is an expected failure. All cases carry the marker `fmu`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    # Imported when an FMU is checked, because pytest loads plugins in every run.
    from congelation.conformance.finding import Verdict
    from congelation.conformance.rule import Rule

__all__ = [
    "FmuFile",
    "RuleItem",
    "Violation",
    "pytest_addoption",
    "pytest_collection_modifyitems",
    "pytest_configure",
]


class Violation(AssertionError):
    """A rule is broken; the text is what pytest shows."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options --fmu and --fmu-time-limit."""
    group = parser.getgroup("fmu", "FMI 2.0 conformance")
    group.addoption(
        "--fmu",
        action="append",
        default=[],
        metavar="PATH",
        help="check this FMU against the rules of FMI 2.0 for co-simulation (may be repeated)",
    )
    group.addoption(
        "--fmu-time-limit",
        type=float,
        default=60.0,
        metavar="SECONDS",
        help="how long a rule may take (default: 60)",
    )
    group.addoption(
        "--fmu-fail-on",
        choices=("violation", "warning", "robustness"),
        default="violation",
        help="the least level of findings that fail (default: violation)",
    )
    group.addoption(
        "--fmu-known",
        metavar="FILE",
        help="TOML file of accepted findings, which are expected failures",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Add the marker, and look whether the FMUs are there."""
    config.addinivalue_line("markers", "fmu: a rule of FMI 2.0, run against an FMU (--fmu)")
    for name in config.getoption("--fmu"):
        if not Path(name).exists():
            raise pytest.UsageError(f"--fmu: there is no FMU at '{name}'")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(
    session: pytest.Session, config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Add the cases of the FMUs, before -k and -m choose.

    Not as arguments of pytest, which reads "[" and "::" in a path in its own way.
    """
    for name in config.getoption("--fmu"):
        path = Path(os.path.abspath(name))
        file: FmuFile = FmuFile.from_parent(session, path=path, nodeid=path.name)
        items.extend(file.collect())


class FmuFile(pytest.File):
    """One FMU; its children are the rules."""

    _verdicts: Mapping[str, Verdict] | None = None

    def collect(self) -> Iterator[RuleItem]:
        """All rules."""
        from congelation.conformance.rules import RULES

        for rule in RULES:
            yield RuleItem.from_parent(self, name=rule.id, rule=rule)

    def verdict(self, rule: Rule) -> Verdict:
        """What became of a rule; all that were chosen are checked together, for the first."""
        from congelation.conformance.runner import check

        if self._verdicts is None:
            chosen = [item.name for item in self.session.items if item.parent is self]
            limit = self.config.getoption("--fmu-time-limit")
            known = self.config.getoption("--fmu-known")
            (report,) = check([self.path], rules=chosen, time_limit=limit, known=known).fmus
            self._verdicts = {verdict.rule.id: verdict for verdict in report.verdicts}
        return self._verdicts[rule.id]


class RuleItem(pytest.Item):
    """One rule, run against one FMU."""

    def __init__(self, *, rule: Rule, **arguments: object) -> None:
        super().__init__(**arguments)  # type: ignore[arg-type]  # whatever pytest hands on
        self.rule = rule
        self.add_marker("fmu")

    def runtest(self) -> None:
        """Check the rule."""
        from congelation.conformance.finding import Finding
        from congelation.conformance.rule import Level, Outcome

        parent = self.parent
        if not isinstance(parent, FmuFile):
            raise TypeError(f"{self.name} belongs to {parent}, not to an FMU")
        verdict = parent.verdict(self.rule)
        if verdict.outcome is Outcome.PASS:
            return
        if verdict.outcome is Outcome.KNOWN:
            pytest.xfail(f"{verdict.breaches[0].what}: {verdict.reason}")
        if verdict.outcome is not Outcome.FOUND:
            pytest.skip(verdict.reason)
        finding = Finding.of(str(self.path), verdict)
        if self.rule.level.weight <= Level(self.config.getoption("--fmu-fail-on")).weight:
            raise Violation("\n".join((str(finding), *finding.evidence)))
        self.add_report_section("call", "finding", str(finding))

    def repr_failure(
        self, excinfo: pytest.ExceptionInfo[BaseException], style: object = None
    ) -> str:
        """The rule and its breaches, without a traceback of the checker."""
        if isinstance(excinfo.value, Violation):
            return f"{excinfo.value}\n\n{self.rule.page()}"
        return str(super().repr_failure(excinfo))

    def reportinfo(self) -> tuple[Path, None, str]:
        """Where and what, for the listing."""
        return self.path, None, f"{self.path.name} {self.rule.id}"
