"""pytest --fmu PATH: every rule of FMI 2.0 as a test case, for each FMU given.

A violation fails; a rule that does not apply is skipped; a known limit of the FMU's wrapper is
an expected failure. All cases carry the marker `fmu`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    # Imported when an FMU is checked, because pytest loads plugins in every run.
    from congelation.conformance.rule import Finding, Rule
    from congelation.conformance.runner import Checker

__all__ = [
    "FmuFile",
    "RuleItem",
    "Violation",
    "pytest_addoption",
    "pytest_collect_file",
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


def pytest_configure(config: pytest.Config) -> None:
    """Add the FMUs to what is collected."""
    config.addinivalue_line("markers", "fmu: a rule of FMI 2.0, run against an FMU (--fmu)")
    for name in config.getoption("--fmu"):
        path = Path(name)
        if not path.is_file():
            raise pytest.UsageError(f"--fmu: there is no FMU at '{name}'")
        config.args.append(str(path.absolute()))


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> FmuFile | None:
    """Collect the FMUs that were asked for."""
    wanted = {Path(name).absolute() for name in parent.config.getoption("--fmu")}
    if file_path.absolute() not in wanted:
        return None
    collector: FmuFile = FmuFile.from_parent(parent, path=file_path)
    return collector


class FmuFile(pytest.File):
    """One FMU; its children are the rules."""

    _checker: Checker | None = None

    def collect(self) -> Iterator[RuleItem]:
        """All rules."""
        from congelation.conformance.rules import RULES

        for rule in RULES:
            yield RuleItem.from_parent(self, name=rule.id, rule=rule)

    def teardown(self) -> None:
        """Remove the unzipped FMU."""
        if self._checker is not None:
            self._checker.__exit__(None, None, None)
            self._checker = None

    def check(self, rule: Rule) -> Finding:
        """Check one rule; the FMU is unzipped for the first."""
        from congelation.conformance.runner import Checker

        if self._checker is None:
            limit = self.config.getoption("--fmu-time-limit")
            self._checker = Checker(self.path, time_limit=limit)
        return self._checker.check(rule)


class RuleItem(pytest.Item):
    """One rule, run against one FMU."""

    def __init__(self, *, rule: Rule, **arguments: object) -> None:
        super().__init__(**arguments)  # type: ignore[arg-type]  # whatever pytest hands on
        self.rule = rule
        self.add_marker("fmu")

    def runtest(self) -> None:
        """Check the rule."""
        from congelation.conformance.rule import Outcome

        parent = self.parent
        if not isinstance(parent, FmuFile):
            raise TypeError(f"{self.name} belongs to {parent}, not to an FMU")
        finding = parent.check(self.rule)
        text = "; ".join(finding.lines)
        if finding.outcome is Outcome.NOT_APPLICABLE:
            pytest.skip(text)
        if finding.outcome is Outcome.KNOWN_LIMIT:
            pytest.xfail(f"{finding.limit}: {text}")
        if finding.outcome is Outcome.VIOLATION:
            raise Violation("\n".join(finding.lines))

    def repr_failure(
        self, excinfo: pytest.ExceptionInfo[BaseException], style: object = None
    ) -> str:
        """The rule and its breaches, without a traceback of the checker."""
        if isinstance(excinfo.value, Violation):
            head = f"{self.rule.id} (FMI 2.0.5, section {self.rule.section}): {self.rule.sentence}"
            return f"{head}\n{excinfo.value}"
        return str(super().repr_failure(excinfo))

    def reportinfo(self) -> tuple[Path, None, str]:
        """Where and what, for the listing."""
        return self.path, None, f"{self.path.name} {self.rule.id}"
