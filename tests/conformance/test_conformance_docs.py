"""The documentation lists the rules and limits as they are."""

from __future__ import annotations

from pathlib import Path

from congelation.conformance.accepted import LIMITS
from congelation.conformance.rules import RULES

PAGE = Path(__file__).parents[2] / "docs" / "conformance.md"


def test_every_rule_and_limit_is_documented() -> None:
    listed = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if "FMI2-" in line]
    rows = [line for line in listed if line.startswith(("| PYTHONFMU", "| FMI2"))]
    assert rows == [
        *(f"| {limit.id} | {limit.rule} | {limit.sentence} |" for limit in LIMITS),
        *(
            f"| {rule.id} | {rule.level.value} | {rule.section} | {rule.sentence} |"
            for rule in RULES
        ),
    ]
