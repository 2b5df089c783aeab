"""Extreme but finite values of everything that can be set: a message, never an exception."""

from __future__ import annotations

import math

import pytest

from congelation.errors import DesignWarning
from congelation.export.build import build
from tests.fmus.instance import DISCARD, ERROR, FMUS, Instance, loaded

pytestmark = pytest.mark.slow

EXTREMES = (1e300, -1e300, 1e150, 1e-150, 1e-300, 5e-324, 0.0)
FATAL = "Fatal py exception"
# Infinite where theta never jumps.
ALLOWED = {"next_event"}


def numbers_of(instance: Instance) -> dict[str, float]:
    names = [n for n, kind in instance.types.items() if kind == "Real" and n not in ALLOWED]
    return dict(zip(names, instance.get(*names), strict=True))


def survives(instance: Instance, parameters=(), inputs=(), h=0.01) -> None:
    """Start, read, step and read again: fmpy raises where a status is fatal."""
    instance.slave.reset()
    instance.messages.clear()
    instance.start(**dict(parameters))
    instance.assign(dict(inputs))
    before = numbers_of(instance)
    status = instance.step(0.0, h)
    lost = [name for n in (before, numbers_of(instance)) for name in n if not math.isfinite(n[name])]
    case = (dict(parameters), dict(inputs), h, lost, instance.messages)
    assert status in (0, DISCARD), case
    assert not any(FATAL in text for _, text in instance.messages), case
    assert instance.errors() or not (lost or status), case
    assert not any("Numerical result" in text for _, text in instance.messages), case


def settable(instance: Instance, kind: str) -> list[str]:
    """The parameters of a type."""
    known = {*instance.inputs, *instance.outputs, "k[1]", "k[2]"}
    found = [n for n, t in instance.types.items() if t == kind and n not in known and n[0] != "P"]
    # Profiles are the same code in every plant: those of one are enough.
    is_other = instance.slave.modelIdentifier.endswith("Plant") and "x[2]" in instance.outputs
    if is_other and instance.slave.modelIdentifier != "MatchedPlant":
        return [n for n in found if not n.startswith("profile[")]
    return found


def test_parameters(fmu):
    with loaded(fmu) as (instance,):
        for name in settable(instance, "Real"):
            for value in EXTREMES:
                survives(instance, {name: value})
        for name in settable(instance, "Integer"):
            for number in (0, -1, 2**31 - 1, -(2**31)):
                survives(instance, {name: number})


def test_parameters_with_each_switch_turned(fmu):
    with loaded(fmu) as (instance,):
        for switch in settable(instance, "Boolean"):
            (turned,) = [not v for v in instance.slave.getBoolean([instance.references[switch]])]
            for name in settable(instance, "Real"):
                for value in (1e300, 1e-300):
                    survives(instance, {switch: turned, name: value})


def test_inputs(fmu):
    with loaded(fmu) as (instance,):
        for name in instance.inputs:
            for value in EXTREMES:
                survives(instance, inputs={name: value})


def test_steps(fmu):
    """Among them one over more jumps of theta than anybody can wait for."""
    with loaded(fmu) as (instance,):
        for h in (1e300, 1e-300, 5e-324):
            survives(instance, h=h)


@pytest.mark.parametrize(
    ("name", "bad", "expected"),
    [
        (
            "ScalarController",
            {"epsilon": 1e-300},
            "epsilon = 1e-300 cannot be used: the equations cannot be computed (a division by "
            "zero); valid with the other values: epsilon = 1.0",
        ),
        ("StateFeedbackController", {"epsilon": 1e-300, "delta": 1.5}, "epsilon = 0.3"),
        ("MatchedController", {"Q[2,2]": 1e300}, "valid with the other values: Q[2,2] = 1.0"),
        ("MatchedController", {"epsilon": 1e-300}, "epsilon = 1e-300 cannot be used: P cannot"),
        ("OutputFeedbackController", {"epsilon": 1e-300}, "epsilon = 1e-300 cannot be used: k"),
        ("OutputFeedbackController", {"r": 1e-300}, "the smallest feasible r is 3.3"),
    ],
)
def test_the_parameter_at_fault_is_named(name, bad, expected):
    with loaded(FMUS / f"{name}.fmu") as (instance,):
        instance.start(**bad)
        (found,) = [text for status, text in instance.messages if status == ERROR]
        assert expected in found
        assert instance.step(0.0, 0.1) == DISCARD


def test_the_value_that_is_called_valid_is(fmu):
    """What a message proposes is accepted."""
    with loaded(fmu) as (instance,):
        if "epsilon" not in instance.types:
            return
        (default,) = instance.get("epsilon")
        instance.slave.reset()
        instance.start(epsilon=1e-300)
        assert f"epsilon = {default}" in instance.errors()[-1]
        instance.slave.reset()
        instance.messages.clear()
        instance.start(epsilon=default)
        assert instance.errors() == []


def test_a_default_table_whose_file_is_gone(tmp_path):
    """Nothing can be evaluated then, and nothing but messages comes of it."""
    (tmp_path / "theta.csv").write_text("0,-1\n1,-2\n")
    spec = tmp_path / "table.toml"
    text = (FMUS.parent / "specs" / "scalar.toml").read_text("utf-8")
    head, tail = text.split("[plant.profile]")
    rest = tail.split("[controller]")[1]
    spec.write_text(
        f'{head}[plant.profile]\n"theta[1]" = [{{table = {{file = "theta.csv"}}}}]\n[controller]{rest}'
    )
    with pytest.warns(DesignWarning, match="is read from a table"):
        build(spec, out=tmp_path)
    (tmp_path / "theta.csv").unlink()
    with loaded(tmp_path / "ScalarPlant.fmu") as (plant,):
        plant.start()
        assert plant.get("x", "theta[1]") == [0.0, 0.0]
        assert "theta.csv" in plant.errors()[-1]
        assert plant.step(0.0, 0.1) == DISCARD
        plant.slave.reset()
        plant.start(**{"profile[1].table.file": ""})
        assert plant.step(0.0, 0.1) == 0
