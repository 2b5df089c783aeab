"""Bad values, bad calls and bad bytes: refused with a message, and the instance lives on."""

from __future__ import annotations

import math

import pytest

from tests.fmus.instance import DISCARD, ERROR, FMUS, loaded

CONTROLLER = FMUS / "OutputFeedbackController.fmu"


@pytest.mark.parametrize(
    ("bad", "expected"),
    [
        ({"y": math.nan}, "y = nan is refused: it must be finite"),
        ({"y": math.inf}, "y = inf is refused: it must be finite"),
        ({"c[2]": 0.0}, "c[2] = 0.0 is refused: it must be positive"),
        ({"d[1]": -1.0}, "d[1] = -1.0 is refused: it must be positive"),
        ({"delta": -1.0}, "delta = -1.0 is refused: it must be non-negative"),
        ({"sign_b_m": 0.5}, "sign_b_m = 0.5 is refused: it must be +1 or -1"),
        ({"Gamma[1,1]": -1.0}, "Gamma is refused: it must be positive definite"),
        ({"Gamma[1,2]": 0.5}, "Gamma[2,1] = 0.0 and Gamma[1,2] = 0.5"),
        ({"r": 5.0, "epsilon": 0.1}, "the smallest feasible r is 10.0499"),
    ],
)
def test_bad_values(bad, expected):
    with loaded(CONTROLLER) as (controller,):
        controller.start(**bad)
        (found,) = [text for status, text in controller.messages if status == ERROR]
        assert expected in found
        assert controller.step(0.0, 0.1) == DISCARD
        assert expected in controller.messages[-1][1]
        # The last good values still hold, and a reset makes the instance as new.
        assert all(math.isfinite(v) for v in controller.get("u", "k[1]", "k[2]"))
        controller.slave.reset()
        controller.start()
        assert controller.step(0.0, 0.1) == 0


def test_good_value_mends_a_bad_one():
    with loaded(CONTROLLER) as (controller,):
        controller.start(y=math.nan)
        assert controller.step(0.0, 0.1) == DISCARD
        controller.set(y=1.0)
        assert controller.step(0.0, 0.1) == 0


def test_parameters_that_fit_only_together():
    """r = 11 needs epsilon = 0.1 and the default epsilon needs r >= 3.4: either order is fine."""
    for order in (("r", "epsilon"), ("epsilon", "r")):
        values = {"r": 11.0, "epsilon": 0.1}
        with loaded(CONTROLLER) as (controller,):
            controller.start(**{name: values[name] for name in order})
            assert controller.errors() == []


def test_parameters_are_fixed_after_initialisation():
    with loaded(CONTROLLER) as (controller,):
        controller.start()
        controller.assign({"gamma": 2.0})
        assert "gamma is fixed and cannot be set after initialization" in controller.errors()[-1]
        assert controller.get("gamma") == [1.0]
        assert controller.step(0.0, 0.1) == DISCARD


@pytest.mark.parametrize(
    ("t", "h", "expected"),
    [
        (0.5, 0.1, "this instance is at t = 0.0"),
        (0.0, 0.0, "the step size must be positive and finite"),
        (0.0, -0.1, "the step size must be positive and finite"),
        (0.0, math.nan, "the step size must be positive and finite"),
        (math.nan, 0.1, "this instance is at t = 0.0"),
        (0.0, 1.5, "it ends after the stop time 1.0"),
    ],
)
def test_bad_steps(t, h, expected):
    with loaded(CONTROLLER) as (controller,):
        controller.start(stop_time=1.0)
        assert controller.step(t, h) == DISCARD
        assert expected in controller.errors()[-1]
        assert controller.step(0.0, 0.1) == 0


def test_step_before_initialisation():
    with loaded(CONTROLLER) as (controller,):
        assert controller.step(0.0, 0.1) == DISCARD
        assert "before fmi2EnterInitializationMode" in controller.errors()[-1]


def test_overflow_is_discarded():
    """A plant driven out of the range of numbers refuses the step and keeps its state."""
    with loaded(FMUS / "StrictFeedbackPlant.fmu") as (plant,):
        plant.start(u=1e308)
        before = plant.get("x[1]", "x[2]")
        assert plant.step(0.0, 100.0) == DISCARD
        assert "the loop diverges" in plant.errors()[-1]
        assert plant.get("x[1]", "x[2]") == before
        plant.set(u=0.0)
        assert plant.step(0.0, 0.1) == 0


def test_unknown_and_mistyped_references():
    with loaded(CONTROLLER) as (controller,):
        controller.start()
        controller.slave.getReal([10_000])
        assert "value reference 10000 is no Real variable" in controller.errors()[-1]
        controller.slave.setReal([controller.references["damping"]], [1.0])
        assert "is no Real that can be set" in controller.errors()[-1]


def test_a_thousand_faults(fmu):
    """No fault, however often, kills the process or the instance."""
    with loaded(fmu) as (instance,):
        # A block that is driven by its own signals has no input.
        references = [instance.references[name] for name in instance.inputs[:1]]
        # Most parameters must be positive or have to fit others; the rest take this value.
        known = {*instance.inputs, *instance.outputs}
        parameters = [n for n, t in instance.types.items() if t == "Real" and n not in known]
        for k in range(1000):
            instance.slave.setReal(references, [math.nan] * len(references))
            instance.assign({parameters[k % len(parameters)]: (-1.0, math.inf)[k % 2]})
            assert instance.step(0.0, -1.0) == DISCARD
            state = instance.slave.deSerializeFMUstate(b"not a state at all")
            instance.slave.setFMUstate(state)
            instance.slave.freeFMUstate(state)
        instance.slave.reset()
        instance.start()
        assert instance.step(0.0, 0.01) == 0
