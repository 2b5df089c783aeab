"""Level sets below which a saturated design never saturates (`certify --umax`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from typer.testing import CliRunner

from congelation.cli import app
from congelation.cosim import Component, Connection, System, simulate
from congelation.errors import InvalidInput
from congelation.theory.closed_loop import Compiled, close
from congelation.theory.lyapunov import scalar_certificate, state_feedback_certificate
from congelation.theory.saturation import largest_level
from congelation.theory.scalar import scalar_controller, scalar_plant
from congelation.theory.state_feedback import state_feedback_controller
from congelation.theory.strict_feedback import SYSTEM_60, strict_feedback_plant
from congelation.verify.certify import certify
from tests.scenarios import FMUS, ROOT

SCALAR = {"k_bar": 1.0, "gamma": 1.0, "epsilon": 1.0, "delta": 1.0, "damping": [1.0]}


def test_the_level_of_the_scalar_example_is_that_of_its_equations():
    """(3): u = -(k - theta_hat) x, k = 2. With theta_hat = ell - a, ell = -3, |u| = u_max lies at
    |x| = u_max/(5 + a), so V = u_max^2/(2 (5 + a)^2) + a^2/2, smallest where a (5 + a)^3 = u_max^2.
    """
    loop = close(scalar_plant(), scalar_controller(), SCALAR)
    for umax in (0.5, 30.0, 400.0):
        found = largest_level(scalar_certificate(loop), umax, [-3.0], [1.0, 0.0])
        a = brentq(lambda a, umax=umax: a * (5 + a) ** 3 - umax**2, 0.0, umax)
        exact = umax**2 / (2 * (5 + a) ** 2) + a**2 / 2
        assert found.v == pytest.approx(exact, rel=1e-6)
        assert found.start == pytest.approx(0.5 + 4.5)
    assert largest_level(scalar_certificate(loop), 30.0, [-3.0], [1.0, 0.0]).holds_start


def test_no_state_inside_saturates_and_one_on_the_edge_does():
    """System (60), ell = (-3, 2): states drawn in z and the error of the estimate."""
    values = {"c": [0.5, 0.5], "epsilon": 0.3, "delta": 2**0.5}
    loop = close(strict_feedback_plant(SYSTEM_60), state_feedback_controller(SYSTEM_60), values)
    certificate = state_feedback_certificate(loop)
    ell, umax = np.array([-3.0, 2.0]), 50.0
    found = largest_level(certificate, umax, ell, [2.0, -1.0, 0.0, 0.0])
    u = Compiled([loop.bound_signal("controller.u")], [loop.arguments[0]])
    generator = np.random.default_rng(1)
    drawn = Compiled([certificate.coordinates.X], [certificate.coordinates.Y, certificate.ell])
    largest = 0.0
    for _ in range(3000):
        direction = generator.normal(size=4)
        inside = direction * np.sqrt(2 * found.v) / np.linalg.norm(direction)  # Gamma = I
        X = drawn(inside, ell)
        assert pytest.approx(found.v) == certificate.at(X, ell).V
        largest = max(largest, abs(u(X).item()))
    assert 0.9 * umax < largest < umax * (1 + 1e-6)
    edge = np.array(list(found.state.values()))
    assert abs(u(edge).item()) == pytest.approx(umax, rel=1e-5)
    assert not found.holds_start


def test_a_saturated_loop_that_starts_inside_never_saturates():
    """As FMUs, theta(t) within 1 of ell = -3: u_max = 30, V(0) = 11 < v* = 11.09."""
    start = {"profile[1].mean": -3.0, "profile[1].square[1].amplitude": 1.0}
    start |= {"profile[1].square[1].period": 0.37}

    def run(x0: float, umax: float) -> tuple[float, float]:
        components = (
            Component("plant", FMUS / "ScalarPlant.fmu", {"x0": [x0], **start}),
            Component("law", FMUS / "ScalarController.fmu", {"theta_hat0": [-5.2]}),
            Component("saturation", FMUS / "Saturation.fmu", {"limit": [umax]}),
        )
        chain = (("plant.x", "law.x"), ("law.u", "saturation.u"), ("saturation.y", "plant.u"))
        links = tuple(Connection(*link) for link in chain)
        record = ["law.u", "saturation.saturated"]
        result = simulate(
            System(components, links),
            stop_time=2.0,
            tolerance=1e-6,
            coupling="hermite",
            record=record,
        )
        return np.max(np.abs(result.values[:, 0])), np.max(np.abs(result.values[:, 1]))

    x0 = np.sqrt(2 * (11.0 - 2.2**2 / 2))
    largest, saturated = run(x0, 30.0)
    assert largest < 30.0
    assert saturated == 0.0
    assert run(x0, 25.0)[1] == 1.0


@pytest.mark.parametrize(
    ("spec", "reason"),
    [("output_feedback", "V does not bound the filters"), ("tracking", "not bound the reference")],
)
def test_where_there_is_none_the_reason_is_told(spec, reason):
    (found,) = certify(ROOT / "specs" / f"{spec}.toml", samples=30, umax=10.0)
    assert found.level is None
    assert reason in found.unlevelled


def test_the_command():
    file = str(ROOT / "specs" / "scalar.toml")
    done = CliRunner().invoke(app, ["certify", file, "--samples", "30", "--umax", "30"])
    assert done.exit_code == 0
    assert "|u| < 30 where V < " in done.output
    assert "starts inside" in done.output or "starts outside" in done.output
    with pytest.raises(InvalidInput, match=r"umax = -1\.0 is not valid"):
        certify(Path(file), umax=-1.0)
