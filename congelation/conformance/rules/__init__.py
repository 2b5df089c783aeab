"""The rules, in the order in which they are reported."""

from __future__ import annotations

from collections.abc import Mapping

from congelation.conformance.rule import Rule
from congelation.conformance.rules import (
    capabilities,
    document,
    experiment,
    fmustate,
    instances,
    library,
    logging,
    package,
    resources,
    robustness,
    serialization,
    states,
    stepping,
    structure,
    values,
    variables,
)

__all__ = ["BY_ID", "RULES"]

RULES: tuple[Rule, ...] = (
    *package.RULES,
    *document.RULES,
    *variables.RULES,
    *structure.RULES,
    *library.RULES,
    *instances.RULES,
    *resources.RULES,
    *experiment.RULES,
    *states.RULES,
    *values.RULES,
    *stepping.RULES,
    *capabilities.RULES,
    *fmustate.RULES,
    *serialization.RULES,
    *logging.RULES,
    *robustness.RULES,
)

BY_ID: Mapping[str, Rule] = {rule.id: rule for rule in RULES}
