"""The table of keys: equal to what the rooms know, and the schemas made of it."""

from __future__ import annotations

import json
import tomllib
from dataclasses import fields
from functools import cache
from pathlib import Path

import jsonschema
import pytest
from typer.testing import CliRunner

from congelation import keys
from congelation.cli import app
from congelation.cosim.coupling import COUPLINGS
from congelation.export.forms import BLOCKS, FILTERS, FORMS
from congelation.scenario.axes import DISTRIBUTIONS, SAMPLINGS
from congelation.scenario.parts import Experiment
from congelation.toml import KINDS, Key, Table
from tests.scenarios import ROOT, SCALAR, SHIPPED

SPECS = sorted((ROOT / "specs").glob("*.toml"))


def tables(table: Table) -> list[Table]:
    inner = [key.table for key in (*table.keys, table.extra) if key is not None and key.table]
    return [table, *(deeper for found in inner for deeper in tables(found))]


EVERY = [key for top in (keys.SCENARIO, keys.SPEC) for table in tables(top) for key in table.keys]


def test_choices_are_those_that_the_rooms_offer() -> None:
    assert keys.EXPERIMENT["coupling"].choices == tuple(COUPLINGS)
    assert keys.SWEEP["sampling"].choices == tuple(SAMPLINGS)
    assert keys.SPEC["form"].choices == (*FORMS, *BLOCKS)
    assert keys.STRUCTURE["filter"].choices == tuple(FILTERS)
    spaced = {"values", "linspace", "logspace"}
    assert {*keys.AXIS.names} == {"set", "variants", *spaced, *DISTRIBUTIONS}
    assert {*keys.STRUCTURE.names} == {
        key for form in (*FORMS.values(), *BLOCKS.values()) for key in form.keys
    }
    assert {*keys.EXPERIMENT.names} == {field.name for field in fields(Experiment)}


def test_defaults_are_those_of_the_experiment() -> None:
    for field in fields(Experiment):
        key = keys.EXPERIMENT[field.name]
        if key.kind != "table" and not key.required:
            expected = () if field.name == "record" else field.default  # none named: all outputs
            assert key.default == expected, field.name


@pytest.mark.parametrize("key", EVERY, ids=lambda key: key.name)
def test_every_key_says_what_it_is(key: Key) -> None:
    assert key.kind in KINDS
    assert key.text
    assert "\n" not in key.text
    assert key.valid
    assert key.required or key.default is None or key.kind != "table"


@cache
def schema(kind: str) -> dict[str, object]:
    done = CliRunner().invoke(app, ["schema", kind])
    assert done.exit_code == 0, done.output
    found: dict[str, object] = json.loads(done.output)
    jsonschema.Draft202012Validator.check_schema(found)
    return found


@pytest.mark.parametrize("file", [*SHIPPED, *SPECS], ids=lambda file: file.name)
def test_the_schemas_admit_what_is_shipped(file: Path) -> None:
    kind = "spec" if file in SPECS else "scenario"
    jsonschema.Draft202012Validator(schema(kind)).validate(tomllib.loads(file.read_text()))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("stop_time = 1.0", "stop_tme = 1.0", "'stop_tme' was unexpected"),
        ("stop_time = 1.0", "", "'stop_time' is a required property"),
        ("step = 0.01", "step = 0", "0 is less than or equal to the minimum of"),
        ("step = 0.01", "step = 0.01\ntolerance = 1", "1 is greater than or equal to the maximum"),
        ("step = 0.01", 'step = 0.01\ncoupling = "jakobi"', "'jakobi' is not one of"),
        ("{square = {", "{sqare = {", "('sqare' was unexpected)"),
        ('title = "A short loop"', "title = 1", "1 is not of type 'string'"),
    ],
)
def test_the_schema_refuses_what_the_loader_refuses(old: str, new: str, message: str) -> None:
    assert old in SCALAR
    document = tomllib.loads(SCALAR.replace(old, new))
    with pytest.raises(jsonschema.ValidationError) as refused:
        jsonschema.validate(document, schema("scenario"))
    assert message in refused.value.message


def test_a_schema_tells_units_defaults_and_ranges() -> None:
    experiment = schema("scenario")["properties"]["experiment"]["properties"]  # type: ignore[index]
    assert experiment["start_time"]["default"] == 0.0
    assert experiment["start_time"]["description"] == "begin of the run (s)"
    assert experiment["output_every"]["minimum"] == 1
    assert experiment["tolerance"]["exclusiveMaximum"] == 1.0


def test_no_other_kind_of_file_has_a_schema() -> None:
    done = CliRunner().invoke(app, ["schema", "fmu"])
    assert done.exit_code == 2
