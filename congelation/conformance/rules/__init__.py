"""The rules: `RULES`, in the order in which they are reported.

Each module registers its rules as it is imported. What is common to all kinds of FMU is in
`package`, `document`, `variables` and `structure`; `model_exchange` is about that, the rest about
co-simulation. Rules for FMI 3.0 are further modules here, with a bench that knows their
functions.

They are imported when `RULES` is first used: a process that looks at one rule imports its module
alone, which takes a third of the time.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from congelation.conformance.rule import BY_ID, Rule

__all__ = ["RULES"]

_MODULES = (
    "package",
    "document",
    "variables",
    "structure",
    "library",
    "instances",
    "experiment",
    "state_machine",
    "values",
    "stepping",
    "capabilities",
    "fmu_states",
    "model_exchange",
    "logging",
    "robustness",
)
"""In the order of the reports."""

if TYPE_CHECKING:
    RULES: tuple[Rule, ...]


def __getattr__(name: str) -> tuple[Rule, ...]:
    """`RULES`, when it is first used."""
    if name != "RULES":
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    for module in _MODULES:
        import_module(f"{__name__}.{module}")
    globals()[name] = found = tuple(BY_ID.values())
    return found
