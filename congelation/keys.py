"""Every key of scenario and spec files: one table, for the loaders, their messages and the schemas.

A `Table` has one `Key` for each key: its type, default, unit, range and a line of text. The JSON
Schemas that editors use to complete and check such files (`congelation schema`) are made of the
same records.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from typing import Any

from congelation.signals import Table as TableTerm
from congelation.signals.kinds import BY_KIND
from congelation.signals.terms import Constant
from congelation.toml import TIME_UNITS, Key, Table

__all__ = ["MOST_RUNS", "SCENARIO", "SPEC", "json_schema"]

MOST_RUNS = 2**20
"""Most runs of each variant of a study: their plan takes half a gigabyte and some minutes."""

LARGEST_ORDER = 100
"""Largest n, m and p of a spec: the derived expressions outgrow any memory long before."""


def _words(text: str) -> tuple[str, ...]:
    return tuple(text.split())


def _term(kind: str) -> Key:
    """The key of a kind of term, from the fields that its class declares."""
    if kind == Constant.kind:
        return Key(kind, "number", "a constant")
    parameters = tuple(
        Key(
            f.name,
            "integer" if f.metadata["type"] == "Integer" else "number",
            f.metadata["description"],
            default=None if f.default is MISSING else f.default,
            required=f.default is MISSING,
            unit=f.metadata["unit"],
            above=0.0 if f.metadata["positive"] else None,
        )
        for f in fields(BY_KIND[kind])
        if f.init
    )
    summary = (BY_KIND[kind].__doc__ or "").splitlines()[0].replace("`", "")
    return Key(kind, "table", summary, table=Table(summary, parameters))


PROFILE = Table(
    "One term of theta(t): a table with one of these keys.",
    (
        *map(_term, BY_KIND),
        Key(
            TableTerm.kind,
            "table",
            "values at given times",
            table=Table(
                "Values at given times, held or joined by lines.",
                (
                    Key("times", "numbers", "increasing times", unit="s"),
                    Key("values", "numbers", "the values at these times"),
                    Key("file", "text", "a CSV file of both, beside the TOML file"),
                    Key("linear", "boolean", "whether lines join the values", default=False),
                ),
            ),
        ),
    ),
)

PROFILES = Table(
    "theta(t) by component, or a block's signals: a number, or an array of terms to add up.",
    extra=Key("theta[j]", "terms", "one component of theta(t), or a signal", table=PROFILE),
)

VALUES = Table(
    "Values by the name of a variable; a vector or matrix takes an array.",
    extra=Key("VARIABLE", "value", "its value, also as {value = .., unit = ..}"),
)

COMPONENT = Table(
    "One FMU of the system.",
    (
        Key(
            "fmu", "text", "name of a file in a fmus/ folder, or a path ending in .fmu", None, True
        ),
        Key("native", "boolean", "take the native twin, fmus/native/NAME.fmu", False),
        Key("start", "table", "start values: parameters, states, inputs", table=VALUES),
        Key("profile", "table", "theta(t) of a plant, signals of a block", table=PROFILES),
    ),
)

EXPERIMENT = Table(
    "What to do with the system.",
    (
        Key("start_time", "time", "begin of the run", 0.0, unit="s"),
        Key("stop_time", "time", "end of the run", None, True, "s"),
        Key(
            "step",
            "time",
            "communication step; with a tolerance, the first one tried",
            unit="s",
            above=0.0,
        ),
        Key(
            "tolerance",
            "number",
            "chooses the steps: how far inputs may be from the outputs that drive them",
            above=0.0,
            below=1.0,
        ),
        Key(
            "coupling",
            "text",
            "how inputs move between communication points",
            "auto",
            choices=_words("auto jacobi gauss_seidel derivative hermite sampled model_exchange"),
        ),
        Key("options", "table", "options of the coupling", table=VALUES),
        Key(
            "slave_tolerance",
            "number",
            "relative tolerance of the integration inside the FMUs; by default a tenth of the "
            "tolerance, without one that of the FMUs",
            above=0.0,
            below=1.0,
        ),
        Key("output_interval", "time", "time between recorded rows", unit="s", above=0.0),
        Key(
            "output_every",
            "integer",
            "records every n-th communication point, the first, the last and those at jumps",
            least=1,
        ),
        Key(
            "max_steps",
            "integer",
            "the run ends after so many steps, those taken back included",
            least=1,
        ),
        Key(
            "record", "texts", "variables to record; by default every number among the outputs", ()
        ),
    ),
)

METRIC = Table(
    "A number that sums up a run, under the name of its column.",
    (
        Key("metric", "text", "which one", None, True),
        Key("of", "text", "variable or vector that it is of; metrics of the closed loop have none"),
    ),
    extra=Key("OPTION", "quantity", "an option of the metric"),
)

FIGURE = Table(
    "A figure of the trajectories.",
    (
        Key("name", "text", "name of its files: letters, digits, - and _", None, True),
        Key("panels", "texts", "one panel each: a variable, or |variable| for its norm", (), True),
        Key("span", "numbers", "[start, stop], the part of the time axis to show", (), unit="s"),
        Key(
            "scale",
            "text",
            "of the vertical axes; auto follows the ranges of the variants",
            "auto",
            choices=("auto", "linear", "log", "symlog"),
        ),
        Key("legend", "boolean", "whether curves are named above the panels", True),
    ),
)

VARIANT = Table(
    "A named change of the scenario.",
    (
        Key("name", "text", "what rows and legends call it", None, True),
        Key(
            "set",
            "table",
            'what it changes: "component.variable", "component.profile.theta[1]", "experiment.key"',
            table=VALUES,
        ),
    ),
)

AXIS = Table(
    "What differs between the points of a sweep, as one of a list or of a distribution.",
    (
        Key("set", "name or names", "a setting, or several that change together", None, True),
        Key("values", "values", "the values; of several settings, rows of a value each"),
        Key("linspace", "numbers", "[first, last, count], equally far apart"),
        Key("logspace", "numbers", "[first, last, count], equal ratios; first and last positive"),
        Key("uniform", "numbers", "[low, high]"),
        Key("log_uniform", "numbers", "[low, high], both positive"),
        Key("normal", "numbers", "[mean, standard deviation]"),
        Key("integers", "numbers", "[first, last], whole numbers"),
        Key(
            "variants",
            "texts",
            "the variants that it is of, by default all; the others are run once without it",
        ),
    ),
)

SWEEP = Table(
    "The points at which every variant is run.",
    (
        Key("axes", "tables", "what differs between points", table=AXIS),
        Key(
            "sampling",
            "text",
            "how the random axes are drawn",
            "random",
            choices=("random", "latin_hypercube", "sobol"),
        ),
        Key("samples", "integer", "draws of the random axes", least=1, most=MOST_RUNS),
        Key("seed", "integer", "of all random numbers", 0, least=0),
        Key("constraints", "texts", "comparisons of settings that every point satisfies", ()),
        Key("replicates", "integer", "how often each point is run", least=1, most=MOST_RUNS),
        Key("reseed", "texts", "the settings that get a fresh seed in each replicate", ()),
        Key("trajectories", "boolean", "whether trajectories are kept", False),
        Key("timeout", "time", "time that a run may take", unit="s", above=0.0),
    ),
)

SCENARIO = Table(
    "A coupled system, its experiment, what is measured and drawn, and its variants.",
    (
        Key("title", "text", "heading of summary and report", None, True),
        Key("connections", "texts", '"plant.x -> controller.x", from an output to an input', ()),
        Key(
            "components",
            "table",
            "the FMUs by name",
            None,
            True,
            table=Table(
                "The FMUs by name.", extra=Key("NAME", "table", "one FMU", table=COMPONENT)
            ),
        ),
        Key("experiment", "table", "what to do with the system", None, True, table=EXPERIMENT),
        Key(
            "metrics",
            "table",
            "numbers that sum up a run",
            table=Table("By column.", extra=Key("NAME", "table", "one metric", table=METRIC)),
        ),
        Key("open", "texts", "inputs that are meant to be left without a connection", ()),
        Key("figures", "tables", "figures of the trajectories", table=FIGURE),
        Key("variants", "tables", "named changes; without any there is one run", table=VARIANT),
        Key("sweep", "table", "the points at which every variant is run", table=SWEEP),
    ),
)

TRANSFER = Table(
    "A transfer function with intervals, for `congelation new --from`.",
    (
        Key("numerator", "values", "b_m .. b_0, each a number or [low, high]", None, True),
        Key("denominator", "values", "1, a_(n-1) .. a_0, the same", None, True),
    ),
)

STRUCTURE = Table(
    "What the form of a spec is derived from; each form has keys of its own.",
    (
        Key("n", "integer", "order of the plant", least=0, most=LARGEST_ORDER),
        Key("m", "integer", "order of the numerator", least=0, most=LARGEST_ORDER),
        Key("p", "integer", "number of parameters", least=0, most=LARGEST_ORDER),
        Key(
            "phibar",
            "table",
            "rows phibar_{i,j} of (10) that are not 0",
            table=Table("By place.", extra=Key("i,j", "numbers", "p numbers")),
        ),
        Key(
            "phi",
            "table",
            "nonlinear regressors phi_i in place of phibar",
            table=Table("By row.", extra=Key("i", "texts", "p formulas in x[1] .. x[i]")),
        ),
        Key(
            "gain",
            "text",
            "the plant's input gain; varying: b(t) is the last element of theta",
            "constant",
            choices=("constant", "varying"),
        ),
        Key("tracking", "boolean", "whether the output follows a reference, input yr", False),
        Key("disturbance", "boolean", "whether the plant is disturbed, input d", False),
        Key(
            "radius",
            "text",
            "whether delta is a parameter of the law, or a term of it is estimated",
            "known",
            choices=("known", "estimated"),
        ),
        Key(
            "law",
            "text",
            "the controller: that of the paper, or a rival of it",
            "congelation",
            choices=("congelation", "bound-estimator", "filtered-transformation"),
        ),
        Key(
            "Upsilon",
            "table",
            "structured variations, theta(t) = Upsilon(t) vartheta + theta_u(t)",
            table=Table("By row.", extra=Key("i", "texts", "formulas in t, as many in each row")),
        ),
        Key("A", "matrix", "of x' = A x + B (u + theta^T x)"),
        Key("B", "matrix", "of x' = A x + B (u + theta^T x)"),
        Key("size", "integer", "number of signals of a block", 1, least=1, most=LARGEST_ORDER),
        Key("sines", "integer", "number of sines of a reference", 2, least=0, most=LARGEST_ORDER),
        Key("filter", "text", "the K-filter", "iss", choices=("iss", "standard")),
    ),
)

_NAME = Key("name", "text", "of the FMU: a C identifier; by default that of the form")
_START = Key(
    "start",
    "table",
    "defaults of its parameters, as numbers alone, in the units of the table units",
    table=VALUES,
)

CONTROLLER = Table("The controller's FMU.", (_NAME, _START))
PLANT = Table(
    "The plant's FMU.", (_NAME, _START, Key("profile", "table", "default theta(t)", table=PROFILES))
)

BLOCK = Table(
    "The FMU of a block.",
    (_NAME, _START, Key("profile", "table", "default signals", table=PROFILES)),
)

SPEC = Table(
    "A plant and its controller, or a block, to build FMUs of.",
    (
        Key("title", "text", "one line on what it is; by default the name of the file"),
        Key(
            "form",
            "text",
            "class of systems",
            None,
            True,
            choices=_words(
                "scalar matched strict-feedback observer "
                "reference disturbance noise saturation lag delay"
            ),
        ),
        Key("structure", "table", "what the form is derived from", table=STRUCTURE),
        Key(
            "units",
            "table",
            "units of variables; the equations of the form have to admit them",
            table=Table(
                "By variable.",
                extra=Key("VARIABLE", "name or names", "one unit, or one for each element"),
            ),
        ),
        Key("plant", "table", "the plant's FMU", table=PLANT),
        Key("controller", "table", "the controller's FMU", table=CONTROLLER),
        Key("block", "table", "the FMU, where the form is a block", table=BLOCK),
    ),
)


def json_schema(table: Table, title: str) -> str:
    """The JSON Schema (draft 2020-12) of files that hold a table, as text.

    It tells keys, types, ranges and defaults; what depends on FMUs (names of variables, their
    shapes) is checked by the loaders alone.
    """
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        **_object(table),
    }
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def _object(table: Table) -> dict[str, Any]:
    """The schema of a table: its keys, and no others unless the user names them."""
    schema: dict[str, Any] = {
        "type": "object",
        "description": table.text,
        "properties": {key.name: _property(key) for key in table.keys},
        "additionalProperties": False if table.extra is None else _property(table.extra),
    }
    if required := [key.name for key in table.keys if key.required]:
        schema["required"] = required
    return schema


def _property(key: Key) -> dict[str, Any]:
    """The schema of the value of a key."""
    text = key.text + (f" ({key.unit})" if key.unit else "")
    schema = {"description": text, **_SCHEMAS[key.kind](key)}
    if key.default not in (None, ()):
        schema["default"] = key.default
    return schema


def _number(key: Key) -> dict[str, Any]:
    bounds = {
        "minimum": key.least,
        "maximum": key.most,
        "exclusiveMinimum": key.above,
        "exclusiveMaximum": key.below,
    }
    return {"type": "number", **{name: b for name, b in bounds.items() if b is not None}}


def _quantity(units: Mapping[str, Any]) -> dict[str, Any]:
    """The schema of a value together with its unit."""
    return {
        "type": "object",
        "properties": {"value": {}, "unit": units},
        "required": ["value", "unit"],
        "additionalProperties": False,
    }


def _text(key: Key) -> dict[str, Any]:
    return {"type": "string", **({"enum": list(key.choices)} if key.choices else {})}


def _terms(key: Key) -> dict[str, Any]:
    """A number, or an array of tables with one key each."""
    if key.table is None:
        raise ValueError(f"{key.name}: terms need a table of their kinds")
    term = {**_object(key.table), "minProperties": 1, "maxProperties": 1}
    return {"anyOf": [{"type": "number"}, {"type": "array", "items": term}]}


def _inside(key: Key) -> dict[str, Any]:
    if key.table is None:
        raise ValueError(f"{key.name}: a key of tables needs a table")
    return _object(key.table)


_STRINGS = {"type": "array", "items": {"type": "string"}}
_NUMBERS = {"type": "array", "items": {"type": "number"}}
_SCHEMAS: Mapping[str, Callable[[Key], dict[str, Any]]] = {
    "text": _text,
    "texts": lambda key: _STRINGS,
    "name or names": lambda key: {"anyOf": [{"type": "string"}, _STRINGS]},
    "number": _number,
    "numbers": lambda key: _NUMBERS,
    "integer": lambda key: {**_number(key), "type": "integer"},
    "boolean": lambda key: {"type": "boolean"},
    "quantity": lambda key: {"anyOf": [_number(key), _quantity({"type": "string"})]},
    "time": lambda key: {
        "anyOf": [_number(key), _quantity({"type": "string", "enum": list(TIME_UNITS)})]
    },
    "table": _inside,
    "tables": lambda key: {"type": "array", "items": _inside(key)},
    # A setting may be a table, too: {controller = {c = [1, 1]}} and the profile of a variant.
    "value": lambda key: {"type": ["number", "boolean", "string", "array", "object"]},
    "values": lambda key: {"type": "array", "minItems": 1},
    "terms": _terms,
    "matrix": lambda key: {"anyOf": [_NUMBERS, {"type": "array", "items": _NUMBERS}]},
}
