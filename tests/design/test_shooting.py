"""Loops under held theta(t): against another integrator, and gradients against differences."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from congelation.design.attack_problem import Problem, problem_of
from congelation.design.shooting import Cells, Shooting
from congelation.scenario.load import load_scenario
from congelation.theory.closed_loop import Compiled, SmoothPiece
from tests.scenarios import ROOT


@pytest.fixture(scope="module", params=["Controller 1", "Controller 2"])
def problem(request: pytest.FixtureRequest) -> Problem:
    return problem_of(load_scenario(ROOT / "scenarios" / "fig2.toml"), request.param)


CELLS = Cells(np.array([0.0, 0.4, 1.0, 2.0]), np.array([[-4.0, 1.0], [-2.0, 3.0], [-4.0, 3.0]]))


def test_solution_is_that_of_another_integrator(problem: Problem) -> None:
    shooting = Shooting(problem.loop, problem.signal("plant.x"), rtol=1e-9, atol=1e-11)
    path = shooting.solve(problem.start, CELLS)
    segments = [
        SmoothPiece(a, b, lambda t, theta=theta: theta)
        for a, b, theta in zip(CELLS.edges[:-1], CELLS.edges[1:], CELLS.theta, strict=True)
    ]
    exact = problem.loop.solve(segments, problem.start, path.time, rtol=1e-11, atol=1e-13)
    x = exact.states[:, :2]
    assert path.finished
    assert np.sqrt(path.size) == pytest.approx(np.linalg.norm(x, axis=1), rel=1e-7, abs=1e-8)
    assert path.integral == pytest.approx(np.trapezoid(np.sum(x**2, axis=1), path.time), rel=2e-2)


@pytest.mark.parametrize("peak", [True, False])
def test_gradients_are_those_of_differences(problem: Problem, peak: bool) -> None:
    shooting = Shooting(problem.loop, problem.signal("plant.x"), rtol=1e-9, atol=1e-11)

    def value(cells: Cells) -> float:
        path = shooting.solve(problem.start, cells)
        return path.size.max() if peak else path.integral

    # So short that |x| still grows: else the largest |v| jumps from one step to another.
    scale = {"Controller 1": 1e-3, "Controller 2": 0.2}[problem.variant] if peak else 1.0
    edges = scale * CELLS.edges
    path = shooting.solve(problem.start, Cells(edges, CELLS.theta), first_step=1e-4)
    assert not peak or path.size.argmax() == len(path.size) - 1
    by_cell, by_edge = shooting.gradient(path, Cells(edges, CELLS.theta), peak)
    for k, j in np.ndindex(*CELLS.theta.shape):
        h = np.zeros_like(CELLS.theta)
        h[k, j] = 1e-4
        rise = value(Cells(edges, CELLS.theta + h)) - value(Cells(edges, CELLS.theta - h))
        assert rise / 2e-4 == pytest.approx(
            by_cell[k, j], rel=1e-4, abs=1e-5 * np.abs(by_cell).max()
        )
    for k in range(1, 3):
        h = np.zeros_like(edges)
        h[k] = 1e-4 * scale
        rise = value(Cells(edges + h, CELLS.theta)) - value(Cells(edges - h, CELLS.theta))
        found = rise / 2e-4 / scale
        assert found == pytest.approx(by_edge[k - 1], rel=1e-3, abs=1e-4 * np.abs(by_edge).max())


def test_merging_and_joining_keep_theta() -> None:
    twice = Cells(np.array([0.0, 1.0, 2.0, 3.0]), np.array([[1.0], [1.0], [2.0]])).merged()
    assert twice.edges.tolist() == [0.0, 2.0, 3.0]
    joined = twice.until(2.5).then(Cells(np.array([2.5, 4.0]), np.array([[5.0]])))
    assert joined.edges.tolist() == [0.0, 2.0, 2.5, 4.0]
    assert joined.theta.ravel().tolist() == [1.0, 2.0, 5.0]


def test_phi_never_falls(problem: Problem) -> None:
    """Phi = ln a + theta_hat_2 has Phi' = x_1^2 / a for any theta, Gamma = I (docs/theory.md)."""
    X, theta = problem.loop.arguments
    (f,) = problem.loop.bind([problem.loop.rate])
    values = problem.loop.values
    eps, delta = values["epsilon"].item(), values["delta"].item()
    damping = (eps**-2 + eps**2 * delta**2) / 2 if problem.variant == "Controller 1" else 0.0
    a = values["c"][0].item() + damping - X[2]
    phi = ca.log(a) + X[3]
    rate = Compiled([ca.jtimes(phi, X, f), X[0] ** 2 / a], [X, theta])
    generator = np.random.default_rng(2018)
    for _ in range(500):
        state = generator.normal(size=4) * 10 ** generator.uniform(-2, 1)
        state[2] = values["c"][0].item() + damping - np.exp(generator.normal())
        found, claimed = rate(state, 10 * generator.normal(size=2))
        assert found == pytest.approx(claimed, rel=1e-9, abs=1e-9 * max(1.0, state @ state) ** 2)
