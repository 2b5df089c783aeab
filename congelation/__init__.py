"""Adaptive control of linear systems with time-varying parameters, co-simulated under FMI 2.0.

The method (congelation of variables) and its equation numbers are those of K. Chen and
A. Astolfi, Adaptive Control of Linear Systems with Time-Varying Parameters, American Control
Conference 2018; "the paper" means this one throughout.

What is public are the names of this module, ``import congelation as cg``; docs/api.md lists them.
They are loaded when they are first used: importing the package costs next to nothing. All other
modules are private, and may change without notice.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from types import ModuleType
from typing import TYPE_CHECKING

# The same names as in _PLACES, for type checkers and editors.
if TYPE_CHECKING:
    from congelation.conformance.runner import check
    from congelation.cosim import (
        Component,
        Connection,
        Output,
        Result,
        Status,
        System,
        simulate,
    )
    from congelation.cosim.coupling import (
        Derivative,
        GaussSeidel,
        Hermite,
        Jacobi,
        ModelExchange,
        Sampled,
    )
    from congelation.cosim.experiment import Experiment
    from congelation.cosim.pair_info import Info, info
    from congelation.design.attack import attack
    from congelation.design.tune import tune
    from congelation.errors import CongelationError, InvalidInput, SlaveError
    from congelation.export.build import build
    from congelation.export.examples import copy_examples as examples
    from congelation.export.examples import write_starter as new
    from congelation.export.spec import Spec
    from congelation.results.results import Results, open_results
    from congelation.scenario.load import load_scenario
    from congelation.scenario.parts import MetricSpec, Variant
    from congelation.scenario.scenario import Scenario
    from congelation.scenario.ssp import write_ssp as export_ssp
    from congelation.sweep.engine import run, sweep
    from congelation.verify.certify import certify
    from congelation.verify.reference import verify

    __version__: str

__all__ = [
    "Component",
    "CongelationError",
    "Connection",
    "Derivative",
    "Experiment",
    "GaussSeidel",
    "Hermite",
    "Info",
    "InvalidInput",
    "Jacobi",
    "MetricSpec",
    "ModelExchange",
    "Output",
    "Result",
    "Results",
    "Sampled",
    "Scenario",
    "SlaveError",
    "Spec",
    "Status",
    "System",
    "Variant",
    "__version__",
    "attack",
    "build",
    "certify",
    "check",
    "examples",
    "export_ssp",
    "info",
    "load_scenario",
    "new",
    "open_results",
    "run",
    "simulate",
    "sweep",
    "tune",
    "verify",
]

_PLACES: Mapping[str, str] = {
    "Component": "cosim:Component",
    "CongelationError": "errors:CongelationError",
    "Connection": "cosim:Connection",
    "Derivative": "cosim.coupling:Derivative",
    "Experiment": "cosim.experiment:Experiment",
    "GaussSeidel": "cosim.coupling:GaussSeidel",
    "Hermite": "cosim.coupling:Hermite",
    "Info": "cosim.pair_info:Info",
    "InvalidInput": "errors:InvalidInput",
    "Jacobi": "cosim.coupling:Jacobi",
    "MetricSpec": "scenario.parts:MetricSpec",
    "Output": "cosim:Output",
    "Result": "cosim:Result",
    "Results": "results.results:Results",
    "ModelExchange": "cosim.coupling:ModelExchange",
    "Sampled": "cosim.coupling:Sampled",
    "Scenario": "scenario.scenario:Scenario",
    "SlaveError": "errors:SlaveError",
    "Spec": "export.spec:Spec",
    "Status": "cosim:Status",
    "System": "cosim:System",
    "Variant": "scenario.parts:Variant",
    "attack": "design.attack:attack",
    "build": "export.build:build",
    "certify": "verify.certify:certify",
    "check": "conformance.runner:check",
    "examples": "export.examples:copy_examples",
    "export_ssp": "scenario.ssp:write_ssp",
    "info": "cosim.pair_info:info",
    "load_scenario": "scenario.load:load_scenario",
    "new": "export.examples:write_starter",
    "open_results": "results.results:open_results",
    "run": "sweep.engine:run",
    "simulate": "cosim:simulate",
    "sweep": "sweep.engine:sweep",
    "tune": "design.tune:tune",
    "verify": "verify.reference:verify",
}
"""Where each public name is: ``module:name`` below this package."""


def __getattr__(name: str) -> object:
    """Load a public name when it is first used."""
    if name == "__version__":
        # Here, as it takes longer to import than all that a process of the check needs.
        from importlib.metadata import version

        found: object = version("congelation")
    elif name in _PLACES:
        module, _, attribute = _PLACES[name].partition(":")
        found = getattr(importlib.import_module(f"congelation.{module}"), attribute)
    else:
        from congelation.errors import nearest

        raise AttributeError(
            f"module 'congelation' has no public name '{name}'; {nearest(name, __all__)}"
        )
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return list(__all__)


class _Face(ModuleType):
    """This module: two of its names, `sweep` and `verify`, are functions and private packages.

    Python enters every imported package as an attribute of the one above it; here that would
    replace the function by the package. ``from congelation.verify.x import y`` needs no such
    attribute.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if not (isinstance(value, ModuleType) and name in _PLACES):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Face
