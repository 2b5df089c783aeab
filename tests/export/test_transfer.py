"""Specs from transfer functions with intervals (`congelation new --from`)."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import ModuleType

import casadi as ca
import numpy as np
import pytest
from typer.testing import CliRunner

from congelation.cli import app
from congelation.errors import InvalidInput
from congelation.export.build import build
from congelation.export.examples import write_starter
from congelation.export.spec import read_spec
from congelation.export.transfer import transfer_function
from congelation.scenario.load import load_scenario
from congelation.verify.certify import certify

PLANT = {"numerator": [2.0, [3.0, 5.0]], "denominator": [2.0, [1.0, 3.0], -1.0, [0.0, 0.4]]}


def test_the_spec_is_of_that_transfer_function(tmp_path):
    """The plant of the spec, linear, from u to y at points of the complex plane; its radii."""
    spec = read_spec(write_starter("servo", tmp_path, PLANT) / "spec.toml")
    plant = spec.plant.model
    (x,), (u,) = plant.states, plant.inputs
    assert plant.theta is not None
    theta = [p.profile.bounds() for p in spec.plant.profiles]
    center = ca.DM([(low + high) / 2 for low, high in theta])
    A, B = (
        np.array(ca.DM(ca.substitute(ca.jacobian(x.rate, v), plant.theta.symbol, center)))
        for v in (x.variables.symbol, u.variables.symbol)
    )
    for s in (0.3j, 1.0 + 2.0j, 5.0):
        y = np.linalg.solve(s * np.eye(3) - A, B)[0, 0]
        exact = np.polyval([2.0, 4.0], s) / np.polyval([2.0, 2.0, -1.0, 0.2], s)
        assert y == pytest.approx(exact)
    # Over the leading 2: a_2 in [0.5, 1.5], a_0 in [0, 0.2].
    assert np.ptp(theta, axis=1).ravel() == pytest.approx([0, 0, 1.0, 0, 0.2])
    values = spec.controller.model.defaults()
    assert values["delta"].item() == pytest.approx(np.hypot(0.5, 0.1), rel=1e-5)
    assert values["delta_1"].item() == pytest.approx(0.5)


def test_what_is_written_builds_and_holds(tmp_path):
    folder = write_starter("servo", tmp_path, {**PLANT, "numerator": [-2.0]}, spread=0.1)
    build(folder / "spec.toml", out=folder / "fmus")
    (found,) = certify(folder / "spec.toml", samples=50)
    assert found.holds
    assert found.warnings == ()
    assert load_scenario(folder / "scenario.toml").title == "servo"


@pytest.fixture
def control() -> ModuleType:
    """Imported by these tests alone: half a second, which each process that collects would take."""
    return import_module("control")


def test_systems_of_python_control(control):
    tf = control.tf([1.0, 2.0], [1.0, 0.4, 4.0])
    for system in (tf, control.ss(tf), control.tf([1, 5, 6], [1, 3.4, 5.2, 12.0])):
        found = transfer_function(system, spread=0.5)
        assert np.array(found.b) == pytest.approx(np.array([[1, 1], [2, 2]]), abs=1e-9)
        assert np.array(found.a) == pytest.approx(np.array([[0.2, 0.6], [2, 6]]), abs=1e-9)


def test_a_numerator_is_hurwitz_for_all_of_its_intervals():
    """Against the zeros at random constants in the intervals, which find what Kharitonov does."""
    generator = np.random.default_rng(5)
    outcomes = []
    for _ in range(60):
        zeta = generator.uniform(0.02, 0.5)
        middle = np.polymul([1.0, 2 * zeta, 1.0], [1.0, generator.uniform(0.1, 2.0)])
        half = generator.uniform(0.0, 0.3, 4) * middle
        b = [[float(m - h), float(m + h)] for m, h in zip(middle, half, strict=True)]
        drawn = middle + half * generator.choice([-1.0, 1.0], (400, 4))
        stable = all(np.roots(row).real.max() < 0 for row in drawn)
        try:
            transfer_function({"numerator": b, "denominator": [1, 0, 0, 0, 0]})
            outcomes.append((True, stable))
        except InvalidInput:
            outcomes.append((False, stable))
    assert {*outcomes} == {(True, True), (False, False)}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"numerator": [[-1, 1]]}, r"numerator: \[-1, 1\] is not valid for its highest power"),
        ({"numerator": [1, -2]}, r"the plant has a zero at 2"),
        ({"numerator": [1, [-0.1, 3]]}, r"the plant has a zero at 0\.1"),
        ({"numerator": [1, 2, 3, 4]}, "fewer zeros than poles"),
        ({"numerator": []}, "give an array of numbers"),
        ({"denominator": [[1, 2], 1]}, r"denominator\[1\] = \[1, 2\] is not valid"),
        ({"denominator": [1, [2, 1]]}, r"denominator\[2\] = \[2, 1\] is not valid"),
        ({"denominator": [1, "two"]}, r"denominator\[2\] = 'two' is not valid"),
        ({"denominator": [1, float("nan")]}, r"denominator\[2\] = nan is not valid"),
        ({"gain": 2.0}, "no other keys"),
    ],
)
def test_what_is_refused(changes, message, tmp_path):
    with pytest.raises(InvalidInput, match=message):
        write_starter("servo", tmp_path, {**PLANT, **changes})
    assert not list(tmp_path.iterdir())


def test_systems_that_are_refused(control):
    two = control.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)))
    for system, message in (
        (two, "2 inputs and 2 outputs"),
        (control.tf([1], [1, 1], 0.1), "discrete time"),
        (3.0, "3.0 is no system"),
    ):
        with pytest.raises(InvalidInput, match=message):
            transfer_function(system)


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    Path("plant.toml").write_text("numerator = [2]\ndenominator = [1, [0.5, 1.5], 0.2]\n")
    done = CliRunner().invoke(app, ["new", "servo", "--from", "plant.toml", "--spread", "0.1"])
    assert done.exit_code == 0, done.output
    assert "theta[3]" in Path("servo/spec.toml").read_text()
    Path("plant.toml").write_text("numerator = [2]\ndenominatr = [1, 1]\n")
    with pytest.raises(InvalidInput, match=r"plant\.toml: denominatr is not known"):
        write_starter("other", tmp_path, "plant.toml")
