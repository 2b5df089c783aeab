"""Constraints on sweep points: what they mean, and that nothing else is let in."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from congelation.errors import InvalidInput
from congelation.scenario.constraint import Constraint
from congelation.scenario.load import load_scenario
from congelation.sweep.sweep_plan import plan_sweep
from tests.scenarios import SCALAR, write

POINT = {
    "a.x": 2.0,
    "b.y[1]": 3.0,
    "plant.profile[1].sine[2].omega": 0.5,
    "experiment.coupling": "d",
}

TRUE = (
    "a.x < b.y[1]",
    "2 * a.x - 1 == b.y[1]",
    "1 < a.x < b.y[1] <= 3",
    "plant.profile[1].sine[2].omega ** 2 < 0.3",
    "not a.x > 2",
    "a.x > 5 or b.y[1] / -3 == -1",
    "experiment.coupling != 'jacobi'",
)
FALSE = ("a.x > b.y[1]", "1 < a.x < 2", "a.x == 2 and b.y[1] == 2", "not a.x == 2")


@pytest.mark.parametrize("text", TRUE)
def test_what_holds(text: str) -> None:
    assert Constraint(text).holds(POINT)


@pytest.mark.parametrize("text", FALSE)
def test_what_does_not_hold(text: str) -> None:
    assert not Constraint(text).holds(POINT)


@given(x=st.floats(-1e6, 1e6), y=st.floats(-1e6, 1e6))
def test_arithmetic_is_that_of_numbers(x: float, y: float) -> None:
    assert Constraint("a.x * b.y + a.x <= 3 * b.y").holds({"a.x": x, "b.y": y}) == (
        x * y + x <= 3 * y
    )


LONG = " + ".join(["a.x"] * 3000) + " < 1"
MISTAKES = {
    LONG: "more than 100 operations inside each other; use several",
    "-" * 5000 + "a.x < 1": "more than 100 operations inside each other",
    "a.x <": "is no comparison",
    "a.x + 1": "compares nothing",
    "exit() < 1": r"'exit\(\)' has no meaning here",
    "[1] < a.x": r"'\[1\]' has no meaning here",
    "a.x < 1j": "'1j' has no meaning here",
}


@pytest.mark.parametrize(("text", "message"), MISTAKES.items())
def test_what_is_no_constraint_is_told(text: str, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        Constraint(text)


def test_many_conditions_are_no_deep_ones() -> None:
    assert Constraint(" and ".join(["a.x < 9"] * 3000)).holds(POINT)


def test_what_cannot_be_evaluated_is_told() -> None:
    for text in ("1 / (a.x - 2) < 1", "experiment.coupling < 1", "9 ** 9 ** 9 ** 9 < a.x"):
        with pytest.raises(InvalidInput, match="cannot be evaluated"):
            Constraint(text).holds(POINT)


SWEEP = """
[sweep]
constraints = ["controller.epsilon * plant.x0[1] <= 1"]
[[sweep.axes]]
set = "controller.epsilon"
values = [0.5, 1.0, 2.0]
[[sweep.axes]]
set = "plant.x0[1]"
values = [0.5, 1.0, 2.0]
"""


def test_a_sweep_leaves_points_out(tmp_path: Path) -> None:
    sweep = load_scenario(write(tmp_path, SCALAR + SWEEP)).sweep
    assert sweep is not None
    found = [(p["controller.epsilon"], p["plant.x0[1]"]) for p in sweep.points()]
    assert found == [(0.5, 0.5), (0.5, 1.0), (0.5, 2.0), (1.0, 0.5), (1.0, 1.0), (2.0, 0.5)]


def test_a_name_that_is_not_swept_is_told_with_its_place(tmp_path: Path) -> None:
    change = ("controller.epsilon *", "controller.epsilo *")
    with pytest.raises(InvalidInput) as told:
        load_scenario(write(tmp_path, SCALAR + SWEEP, change))
    assert "sweep.constraints: 'controller.epsilo * plant" in str(told.value)
    assert "'controller.epsilo' is not swept; did you mean 'controller.epsilon'?" in str(told.value)


def test_what_cannot_be_evaluated_at_a_point_is_told_with_its_place(tmp_path: Path) -> None:
    change = ("controller.epsilon * plant.x0[1]", "1 / (controller.epsilon - 2)")
    file = write(tmp_path, SCALAR + SWEEP, change)
    with pytest.raises(InvalidInput) as told:
        plan_sweep(load_scenario(file), tmp_path / "out", resume=False)
    assert str(told.value).startswith(f"{file}: sweep.constraints: '1 / (controller")
    assert "cannot be evaluated: " in str(told.value)
