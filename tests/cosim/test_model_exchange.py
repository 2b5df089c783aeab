"""The coupling `model_exchange`: one integrator over the states of all FMUs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from congelation.cosim import (
    Component,
    Connection,
    Experiment,
    ModelExchange,
    Output,
    Result,
    SlavePool,
    Status,
    System,
    perform,
    simulate,
)
from congelation.cosim.compiled import library
from congelation.errors import InvalidInput
from congelation.scenario.load import load_scenario
from congelation.scenario.parts import Case
from congelation.verify.reference import reference
from tests.cosim.c_fmus import bouncing_fmu
from tests.scenarios import FMUS, ROOT

COUPLING = "model_exchange"


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bouncing_fmu(tmp_path_factory.mktemp("ball"))


def by_both(monkeypatch: pytest.MonkeyPatch, system: System, **given: Any) -> tuple[Result, Result]:
    """The same run by the compiled integrator, and by SciPy's."""
    fast = simulate(system, **given)
    with monkeypatch.context() as patch:
        patch.setattr(library, "loaded", lambda: None)
        return fast, simulate(system, **given)


def native(name: str, variant: int) -> Case:
    scenario = load_scenario(ROOT / "scenarios" / f"{name}.toml")
    case = scenario.case(scenario.variants[variant].settings)
    parts = tuple(
        replace(c, fmu=FMUS / "native" / Path(c.fmu).name) for c in case.system.components
    )
    return replace(case, system=replace(case.system, components=parts))


def errors(case: Case, result: Result) -> dict[str, float]:
    """Largest error of each column, relative to its peak, against the loop derived anew."""
    times, rows = np.unique(result.time, return_inverse=True)
    exact = reference(case).solve(times)
    return {
        name: np.abs(result.column(name) - exact[name][rows]).max() / np.abs(exact[name]).max()
        for name in result.names
        if name in exact
    }


@pytest.mark.parametrize("output", [Output(), Output(interval=0.013)])
@pytest.mark.parametrize(
    ("name", "variant", "tolerance"), [("fig2", 1, 1e-9), ("fig3", 0, 1e-10), ("scalar", 0, 1e-9)]
)
def test_dop853_is_the_monolithic_solution(
    monkeypatch: pytest.MonkeyPatch, name: str, variant: int, tolerance: float, output: Output
) -> None:
    """Over jumps of theta; rows between steps are of the states there."""
    case = native(name, variant)
    fast, slow = by_both(
        monkeypatch,
        case.system,
        stop_time=3.0,
        tolerance=tolerance,
        coupling=COUPLING,
        output=output,
    )
    for result in (fast, slow):
        assert result.completed, result.message
        assert result.statistics.events > 0
        assert max(errors(case, result).values()) < 1e-6
    assert fast.time.shape == slow.time.shape
    assert (np.diff(fast.time) > 0).all()


@pytest.mark.parametrize(("method", "tolerance"), [("Radau", 1e-6), ("BDF", 1e-8), ("LSODA", 1e-8)])
def test_other_methods_reach_the_same(
    monkeypatch: pytest.MonkeyPatch, method: str, tolerance: float
) -> None:
    case = native("fig2", 1)
    for result in by_both(
        monkeypatch,
        case.system,
        stop_time=1.0,
        tolerance=tolerance,
        coupling=ModelExchange(method),
        output=Output(interval=0.05),
    ):
        assert result.completed, result.message
        assert max(errors(case, result).values()) < 1e-5


def bouncing(ball: Path, start: dict[str, float], links: Sequence[str] = ()) -> System:
    values = {"g": 10.0, "e": 0.5, "x0": 1.0}
    return System((Component("ball", ball, values | start),), tuple(map(Connection.parse, links)))


def test_event_indicators(monkeypatch: pytest.MonkeyPatch, ball: Path) -> None:
    """A ball that bounces: impacts at sqrt(2/g), then after twice the speed over g each."""
    fall = np.sqrt(2.0 / 10.0)
    impacts = fall * np.array([1.0, 2.0, 2.5, 2.75])
    for result in by_both(
        monkeypatch, bouncing(ball, {}), stop_time=1.2, tolerance=1e-8, coupling=COUPLING
    ):
        assert result.completed, result.message
        # At each impact, and where the ball is above the floor again.
        assert result.statistics.events == 6
        y = result.column("ball.y")
        hits = result.time[np.abs(y) < 1e-9]
        assert np.abs(hits - impacts[:3, None]).min(axis=1).max() < 1e-9
    for result in by_both(
        monkeypatch,
        bouncing(ball, {}),
        stop_time=0.8,
        tolerance=1e-8,
        coupling=COUPLING,
        output=Output(interval=0.01),
    ):
        since = result.time - fall
        expected = np.where(
            since < 0.0,
            1.0 - 5.0 * result.time**2,
            5.0 * fall * since - 5.0 * since**2,
        )
        assert result.column("ball.y") == pytest.approx(expected, abs=1e-8)


def test_step_events_and_the_end(monkeypatch: pytest.MonkeyPatch, ball: Path) -> None:
    """A completed step may ask for an event, and for the end of the run."""
    system = bouncing(ball, {"e": 0.0, "asks": 0.2, "ends": 0.6})
    for result in by_both(
        monkeypatch,
        system,
        stop_time=1.0,
        tolerance=1e-6,
        coupling=COUPLING,
        output=Output(interval=0.05),
    ):
        assert result.status is Status.TERMINATED
        assert "ball at t = " in result.message
        assert 0.6 <= result.time[-1] < 1.0
        assert result.column("ball.kicks")[0] == 0.0
        assert result.column("ball.kicks")[-1] == 1.0


def ring(ball: Path, d: tuple[float, float]) -> System:
    """Two oscillators with direct feedthrough, each driven by the other."""
    parts = tuple(
        Component(name, ball, {"w": w, "b": 1.0, "d": d[k], "x0": x0})
        for k, (name, w, x0) in enumerate((("a", 30.0, 1.0), ("b", 50.0, -0.5)))
    )
    return System(parts, (Connection("a.y", "b.u"), Connection("b.y", "a.u")))


@pytest.mark.parametrize("d", [(0.0, 0.0), (0.7, 0.0), (0.7, -0.6)])
def test_feedthrough_and_algebraic_loops(
    monkeypatch: pytest.MonkeyPatch, ball: Path, d: tuple[float, float]
) -> None:
    """Against the matrix exponential of the system with the loop solved by hand."""
    # y_a = x_a + d_a y_b, y_b = x_b + d_b y_a
    Y = np.linalg.solve(np.array([[1.0, -d[0]], [-d[1], 1.0]]), np.eye(2))
    A = np.zeros((4, 4))  # x_a, v_a, x_b, v_b
    A[0, 1] = A[2, 3] = 1.0
    A[1, 0], A[3, 2] = -30.0, -50.0
    A[1, [0, 2]] += Y[1]
    A[3, [0, 2]] += Y[0]
    for result in by_both(
        monkeypatch, ring(ball, d), stop_time=1.0, tolerance=1e-9, coupling=COUPLING
    ):
        assert result.completed, result.message
        for time, row in zip(result.time, result.values, strict=True):
            x = expm(A * time) @ [1.0, 0.0, -0.5, 0.0]
            y = dict(zip(result.names, row, strict=True))
            assert [y["a.y"], y["b.y"]] == pytest.approx(Y @ x[[0, 2]], abs=1e-7)


def test_a_loop_without_solution_ends_the_run(monkeypatch: pytest.MonkeyPatch, ball: Path) -> None:
    for result in by_both(
        monkeypatch, ring(ball, (1.0, 1.0)), stop_time=1.0, tolerance=1e-6, coupling=COUPLING
    ):
        assert result.status is Status.LOOP_UNSOLVED
        assert "a.y -> b.u" in result.message


@pytest.mark.parametrize(
    ("fault", "status", "words"),
    [
        (1.0, Status.STEP_TOO_SMALL, "still too long for the integrator"),
        (2.0, Status.STEP_TOO_SMALL, "still too long for the integrator"),
        (3.0, Status.SLAVE_FAILED, "fmi2GetDerivatives returned fmi2Error"),
        (4.0, Status.LOOP_UNSOLVED, "keep changing"),
        (5.0, Status.SLAVE_FAILED, "announces its next event for t = 0"),
    ],
)
def test_faults(
    monkeypatch: pytest.MonkeyPatch, ball: Path, fault: float, status: Status, words: str
) -> None:
    """The same status, and the same point of time, in both."""
    system = bouncing(ball, {"fault": fault, "asks": 0.4, "w": 900.0, "e": 0.0})
    fast, slow = by_both(monkeypatch, system, stop_time=1.0, tolerance=1e-6, coupling=COUPLING)
    for result in (fast, slow):
        assert result.status is status, result.message
        assert words in result.message
    assert fast.time[-1] == pytest.approx(slow.time[-1], abs=1e-6)
    assert 0.3 < fast.time[-1] < 0.51


def test_a_pool_lends_both_kinds() -> None:
    """Of one FMU, and what is set up is used again."""
    case = native("scalar", 0)
    runs = {}
    with SlavePool() as pool:
        for _ in range(2):
            for coupling in (COUPLING, "hermite"):
                result = perform(
                    case.system,
                    Experiment(stop_time=0.5, tolerance=1e-8, coupling=coupling),
                    pool=pool,
                )
                assert result.completed, result.message
                rows = runs.setdefault(coupling, result.values.tobytes())
                assert rows == result.values.tobytes()


@pytest.mark.parametrize("most", [1, 7, 20])
def test_most_steps(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    for result in by_both(
        monkeypatch,
        native("scalar", 0).system,
        stop_time=9.0,
        tolerance=1e-9,
        coupling=COUPLING,
        max_steps=most,
    ):
        assert result.status is Status.TOO_MANY_STEPS
        assert result.statistics.macro_steps + result.statistics.rejected >= most
        assert len(result.time) <= most + 1


def test_what_is_refused() -> None:
    scenario = load_scenario(ROOT / "scenarios" / "scalar.toml")
    system = scenario.case(scenario.variants[0].settings).system
    with pytest.raises(InvalidInput, match=r"'plant': ScalarPlant.fmu offers no model exchange"):
        simulate(system, stop_time=1.0, tolerance=1e-6, coupling=COUPLING)
    system = native("scalar", 0).system
    with pytest.raises(InvalidInput, match="chooses its steps by a tolerance"):
        simulate(system, stop_time=1.0, step=1e-3, coupling=COUPLING)
    with pytest.raises(InvalidInput, match="valid: DOP853, Radau, BDF, LSODA"):
        simulate(
            system, stop_time=1.0, tolerance=1e-6, coupling=COUPLING, options={"method": "Euler"}
        )
    with pytest.raises(InvalidInput, match="a tenth of the tolerance"):
        simulate(system, stop_time=1.0, tolerance=1e-6, coupling=COUPLING, trust=True)
