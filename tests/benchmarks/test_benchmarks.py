"""The benchmarks run, and their own arithmetic is right; no time is looked at."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import __main__ as command
from benchmarks import studies
from benchmarks.accuracy import Held, error_of
from benchmarks.cases import figure, native
from benchmarks.exact import Exact
from benchmarks.peers.equation import Equation
from benchmarks.timing import Timing, interleaved, median_ratio
from benchmarks.workers import EngineError, Worker


def test_quick_run_writes_every_table(capsys: pytest.CaptureFixture[str]) -> None:
    before = command.PAGE.read_bytes()

    assert command.main(["--quick"]) == 0

    text = capsys.readouterr().out
    titles = [line for line in text.splitlines() if line.startswith("### ")]
    assert titles == [
        "### Cost per macro step with held inputs",
        "### Time to accuracy, Fig. 2, Controller 1",
        "### Against no FMUs at all",
        "### Small measurements",
        "### A sweep on two workers",
        "### Outside the stepping loop",
        "### Many short runs",
        "### Against fresh FMPy instances",
    ]
    assert "Not run" not in text
    assert command.PAGE.read_bytes() == before


def test_page_is_replaced_between_its_markers_only() -> None:
    part = command.Part("one", lambda _: [])
    page = "head\n<!-- begin one -->\nold\n<!-- end one -->\ntail\n"

    assert part.replaced(page, "new") == (
        "head\n<!-- begin one -->\n\nnew\n\n<!-- end one -->\ntail\n"
    )
    with pytest.raises(ValueError, match="has no markers <!-- begin one -->"):
        part.replaced("head", "new")


def test_page_has_the_markers_of_every_part() -> None:
    page = command.PAGE.read_text("utf-8")

    for part in (command.ENGINE_PART, command.SWEEP_PART, command.LONG_PART):
        assert part.replaced(page, "new") != page


def test_studies_run() -> None:
    whole, outside = studies.in_one_process(2)
    assert whole > outside > 0.0


@pytest.mark.slow
def test_compiled_solvers_meet_the_exact_solution(tmp_path: Path) -> None:
    """DOP853 on the functions of the native FMUs, as it is compared with; nothing is fetched."""
    shipped = figure("fig2")
    equation = Equation(native(shipped), tmp_path, peers=())
    rows = equation.rows(equation.run("DOP853", 1e-9))
    rows = rows[rows[:, 0] <= 1.0]
    exact = Exact(shipped, 1.0)
    assert equation.methods == ("DOP853",)
    assert error_of(rows, exact.values(rows[:, 0])) < 1e-8


@pytest.mark.parametrize("engine", ["fmpy_loop", "fmpy_ssp", "libcosim", "ecos", "cofmupy"])
def test_engines_solve_the_same_loop(engine: str) -> None:
    """Against our own master: equal up to the engine's start, so to first order in the step."""
    loop = figure("fig2").loop
    errors = []
    for step in (1e-4, 5e-5):
        count = round(2e-3 / step)
        with Worker("ours", loop) as ours, Worker(engine, loop) as other:
            _, expected = ours.trajectory(steps=count, step=step)
            _, found = other.trajectory(steps=count, step=step)
        assert found.shape == expected.shape
        np.testing.assert_allclose(found[:, 0], expected[:, 0], rtol=1e-12)
        # x alone: the engines differ in which of two inputs the recorded u belongs to.
        errors.append(np.abs(found[-1, 1:3] - expected[-1, 1:3]).max())

    assert errors[1] <= max(0.6 * errors[0], 1e-9)


def test_monolithic_program_meets_the_exact_solution() -> None:
    found = figure("fig3")
    with Worker("monolithic", found.loop) as worker:
        _, rows = worker.trajectory(method="DOP853", rtol=1e-10, stop_time=1.0)

    assert rows[-1, 0] == 1.0
    # 0.65 s is a jump of theta: the solver stops there.
    assert np.count_nonzero(rows[:, 0] == 0.65) == 2
    assert error_of(rows, Exact(found, 1.0).values(rows[:, 0])) < 1e-8


def test_a_failing_run_leaves_the_worker_alive() -> None:
    with Worker("ours", figure("fig2").loop) as worker:
        with pytest.raises(EngineError, match="diverges"):
            worker.seconds(steps=100, step=0.05)

        assert worker.seconds(steps=10, step=1e-4) > 0.0


def test_held_inputs_are_extrapolated_at_their_order() -> None:
    held = Held((4e-3, 2e-3, 1e-3), (0.16, 0.04, 0.01), seconds_per_step=1e-4, stop_time=10.0)

    assert held.order == pytest.approx(2.0)
    assert held.seconds(1e-4) == pytest.approx(10.0 / 1e-4 * 1e-4)


def test_error_is_relative_to_each_peak() -> None:
    exact = np.array([[1.0, 100.0], [2.0, -200.0]])
    rows = np.array([[0.0, 1.0, 101.0], [1.0, 2.002, -200.0]])

    assert error_of(rows, exact) == pytest.approx(0.005)


def test_repetitions_are_interleaved_and_compared_round_by_round() -> None:
    calls: list[str] = []

    def measure(name: str, values: list[float]) -> float:
        calls.append(name)
        return values[calls.count(name) - 1]

    found = interleaved(
        {
            "a": lambda: measure("a", [9.0, 2.0, 40.0, 6.0]),
            "b": lambda: measure("b", [9.0, 1.0, 10.0, 3.0]),
        },
        rounds=3,
    )

    assert calls == ["a", "b"] * 4
    assert found["a"] == Timing((2.0, 40.0, 6.0))
    assert median_ratio(found["a"], found["b"]) == 2.0


def test_engines_name_what_they_lack(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.workers.ROOT", tmp_path)

    with pytest.raises(EngineError, match=r"run `make \.venv-cofmupy/installed`"):
        Worker("cofmupy", figure("fig2").loop)
