"""The rules, in the order in which they are reported.

Each module registers its rules as it is imported. What is common to all kinds of FMU is in
`package`, `document`, `variables` and `structure`; the rest is about co-simulation. Rules for model
exchange or for FMI 3.0 are further modules here, with a bench that knows their functions.
"""

from congelation.conformance.rule import BY_ID, Rule

# The order of these imports is that of the reports.
from congelation.conformance.rules import package  # isort: skip
from congelation.conformance.rules import document  # isort: skip
from congelation.conformance.rules import variables  # isort: skip
from congelation.conformance.rules import structure  # isort: skip
from congelation.conformance.rules import library  # isort: skip
from congelation.conformance.rules import instances  # isort: skip
from congelation.conformance.rules import resources  # isort: skip
from congelation.conformance.rules import experiment  # isort: skip
from congelation.conformance.rules import states  # isort: skip
from congelation.conformance.rules import values  # isort: skip
from congelation.conformance.rules import stepping  # isort: skip
from congelation.conformance.rules import capabilities  # isort: skip
from congelation.conformance.rules import fmustate  # isort: skip
from congelation.conformance.rules import serialization  # isort: skip
from congelation.conformance.rules import logging  # isort: skip
from congelation.conformance.rules import robustness  # isort: skip

__all__ = [
    "RULES",
    "capabilities",
    "document",
    "experiment",
    "fmustate",
    "instances",
    "library",
    "logging",
    "package",
    "resources",
    "robustness",
    "serialization",
    "states",
    "stepping",
    "structure",
    "values",
    "variables",
]

RULES: tuple[Rule, ...] = tuple(BY_ID.values())
