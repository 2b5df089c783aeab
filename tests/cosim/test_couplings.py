"""Couplings against the monolithic solution: orders, jumps, mixed systems, loops, roll-back."""

import itertools
import math

import numpy as np
import pytest

from congelation.cosim import (
    Component,
    Connection,
    Hermite,
    Status,
    System,
    compiled,
    simulate,
)
from congelation.cosim.coupling.hermite import HermiteStepper
from congelation.errors import InvalidInput
from congelation.fmi.slave import StepDiscarded
from tests.scenarios import FMUS

from .monolithic import order, solution

RECORD = ["plant.x", "controller.q"]


def error(system, solution_of=solution, **kwargs):
    """Largest error over all rows, and the result."""
    result = simulate(system, stop_time=3.0, record=RECORD, **kwargs)
    assert result.completed, result.message
    return np.abs(result.values - solution_of(result.time)).max(), result


@pytest.mark.parametrize(
    ("coupling", "options", "steps", "expected"),
    [
        ("jacobi", {}, (0.04, 0.02, 0.01), 1.0),
        ("gauss_seidel", {}, (0.04, 0.02, 0.01), 1.0),
        ("derivative", {}, (0.1, 0.05, 0.025), 2.0),
        ("derivative", {"sequence": "jacobi"}, (0.1, 0.05, 0.025), 2.0),
        ("hermite", {"iterations": 2}, (0.2, 0.1, 0.05), 4.0),
        ("hermite", {"iterations": 3}, (0.2, 0.1, 0.05), 4.0),
        ("hermite", {}, (0.2, 0.1, 0.05), 4.0),
        ("hermite", {"order": 4}, (0.2, 0.1, 0.05), 4.0),
    ],
)
def test_the_error_falls_with_the_order(loop, coupling, options, steps, expected):
    errors = [error(loop(), coupling=coupling, options=options, step=h)[0] for h in steps]
    assert order(steps, errors) == pytest.approx(expected, abs=0.25)


def test_derivatives_that_are_connected_count_where_inputs_are_held():
    """The FMUs extrapolate by them: of second order in place of first."""
    blocks = [("plant", "ScalarPlant", {"x0": [1.0]}), ("controller", "ScalarController", {})]
    components = tuple(
        Component(name, FMUS / "native" / f"{fmu}.fmu", start) for name, fmu, start in blocks
    )
    values = ["plant.x -> controller.x", "controller.u -> plant.u"]
    slopes = ["plant.der(x) -> controller.der(x)", "controller.der(u) -> plant.der(u)"]

    def end(links, **kwargs):
        system = System(components, tuple(map(Connection.parse, links)))
        result = simulate(system, stop_time=1.0, record=["plant.x"], **kwargs)
        return result.values[-1, 0]

    exact = end(values, coupling="hermite", tolerance=1e-9)
    for links, expected in ((values, 1.0), ([*values, *slopes], 2.0)):
        steps = (0.02, 0.01)
        errors = [abs(end(links, coupling="jacobi", step=h) - exact) for h in steps]
        assert order(steps, errors) == pytest.approx(expected, abs=0.25)


def test_of_order_six_the_first_step_leaves_order_five(loop):
    steps = (0.2, 0.1, 0.05)
    options = {"order": 6}
    errors = [error(loop(), coupling="hermite", options=options, step=h)[0] for h in steps]
    lower = [error(loop(), coupling="hermite", step=h)[0] for h in steps]
    assert order(steps, errors) == pytest.approx(5.0, abs=0.35)
    assert errors[-1] < lower[-1] / 3.0


@pytest.mark.parametrize(
    ("coupling", "steps", "expected"),
    [("derivative", (0.08, 0.04, 0.02), 2.0), ("hermite", (0.16, 0.08, 0.04), 4.0)],
)
def test_jumps_do_not_lower_the_order(loop, coupling, steps, expected):
    errors, results = zip(
        *(
            error(loop({"a": 1.0}), lambda t: solution(t, a=1.0), coupling=coupling, step=h)
            for h in steps
        ),
        strict=True,
    )
    assert order(steps, errors) == pytest.approx(expected, abs=0.35)
    for result in results:
        assert result.statistics.events == 4
        assert {0.65, 1.3, 3 * 0.65, 2.6} <= set(result.time.tolist())


@pytest.mark.parametrize(
    "kwargs",
    [
        {"coupling": "hermite", "tolerance": 1e-4},
        {"coupling": "derivative", "tolerance": 1e-3},
        {"coupling": "derivative", "step": 0.05},
        {"coupling": "hermite", "step": 1e300},
    ],
)
def test_a_run_may_end_a_rounding_error_before_or_after_a_jump(loop, kwargs):
    """Four half periods of 0.65 s, less or more so many units in the last place."""
    system = loop({"a": 1.0})
    end = simulate(system, stop_time=2.59, record=RECORD, **kwargs).values[-1]
    for units in (-12, -8, -3, -1, 0, 1, 2, 8, 12):
        stop = 2.6 + units * math.ulp(2.6)
        result = simulate(system, stop_time=stop, record=RECORD, **kwargs)
        assert result.completed, (units, result.message)
        assert result.time[-1] == stop
        assert (np.diff(result.time) > 0.0).all()
        assert result.statistics.events in (3, 4)
        assert result.values[-1] == pytest.approx(end, abs=0.05)


def test_jumps_on_grid_points_add_no_rows(loop):
    result = simulate(loop({"a": 1.0}), stop_time=2.6, step=0.13, coupling="hermite")
    assert result.statistics.events == 4
    assert len(result.time) == 21
    assert np.abs(result.time - 0.13 * np.arange(21)).max() < 1e-14


def test_a_jump_at_the_stop_time_ends_the_run_there(loop):
    for kwargs in (
        {"step": 0.1, "coupling": "derivative"},
        {"tolerance": 1e-4, "coupling": "hermite"},
    ):
        result = simulate(loop({"a": 1.0}), stop_time=1.3, record=["plant.next_event"], **kwargs)
        assert result.completed
        assert result.time[-1] == 1.3
        assert result.values[-1, 0] == 3 * 0.65


@pytest.mark.parametrize("coupling", ["hermite", "derivative"])
@pytest.mark.parametrize("a", [0.0, 1.0])
def test_the_error_follows_the_tolerance(loop, coupling, a):
    for tolerance in (1e-3, 1e-4, 1e-5):
        largest, result = error(
            loop({"a": a}), lambda t: solution(t, a=a), coupling=coupling, tolerance=tolerance
        )
        assert largest < tolerance
        assert 0.0 < result.statistics.estimated_error <= tolerance
        assert result.time[-1] == 3.0


def test_hermite_needs_few_steps_for_a_small_error(loop):
    largest, result = error(loop(), coupling="hermite", tolerance=1e-7)
    assert largest < 2e-8
    assert result.statistics.macro_steps < 150


def test_quasi_newton_iterations_follow_a_loop_whose_gain_plain_iterations_cannot(loop):
    gains = {"k": 1e3, "d": 1e3}
    system = loop({"a": 1.0}, gains)
    steps = {}
    for acceleration in ("broyden", "none"):
        largest, result = error(
            system,
            lambda t: solution(t, a=1.0, **gains),
            coupling="hermite",
            tolerance=1e-4,
            options={"acceleration": acceleration},
        )
        assert largest < 1e-4
        steps[acceleration] = result.statistics.iterations
    assert 4 * steps["broyden"] < steps["none"]


def test_iterations_that_do_not_converge_name_the_connection(loop):
    result = simulate(
        loop(controller={"k": 1e3, "d": 1e3}),
        stop_time=1.0,
        step=0.1,
        coupling="hermite",
        options={"acceleration": "none"},
    )
    assert result.status is Status.NOT_CONVERGED
    assert "controller.u -> plant.u" in result.message
    assert "at most 12" in result.message
    assert len(result.time) >= 1


@pytest.mark.parametrize("coupling", ["hermite", "derivative"])
def test_a_rejected_step_leaves_no_trace(loop, coupling, monkeypatch):
    """Every third attempt is refused once, and then tried again at the same length."""
    from congelation.cosim import adaptive_step
    from congelation.cosim.step_size import StepSize

    kwargs = {"stop_time": 2.0, "tolerance": 1e-4, "coupling": coupling}
    plain = simulate(loop({"a": 1.0}), **kwargs)
    assert plain.statistics.rejected == 0

    tried, count = adaptive_step.attempted, {"attempts": 0, "forced": 0}

    def sometimes_refused(*arguments):
        trial, error = tried(*arguments)
        count["attempts"] += 1
        if count["attempts"] % 3 == 0:
            count["forced"] += 1
            return trial, np.inf
        return trial, error

    monkeypatch.setattr(
        compiled.library, "loaded", lambda: None
    )  # what is patched is the Python loop
    monkeypatch.setattr(adaptive_step, "attempted", sometimes_refused)
    monkeypatch.setattr(StepSize, "refused", lambda self, error, length, order: self)
    forced = simulate(loop({"a": 1.0}), **kwargs)
    assert forced.statistics.rejected == count["forced"] > 3
    assert np.array_equal(forced.time, plain.time)
    assert np.array_equal(forced.values, plain.values)


def test_a_step_that_an_fmu_discards_is_tried_shorter(fmus):
    file = fmus / "TestFaulty.fmu"
    system = System((Component("f", file, {"r": -1.0, "longest": 0.01}),))
    result = simulate(
        system, stop_time=1.0, step=0.2, tolerance=1e-4, coupling="hermite", record=["f.y"]
    )
    assert result.completed
    assert result.statistics.rejected >= 1
    assert result.values[-1, 0] == pytest.approx(np.exp(-1.0), rel=1e-9)


def test_no_step_is_kept_that_a_later_iteration_could_not_make(monkeypatch, loop):
    """Where jumps pass, the shortest steps are kept whatever their error; this one is not made."""
    iterated, last = HermiteStepper._iterated, []

    def discarded(self, piece, points, time, end):
        new = iterated(self, piece, points, time, end)
        again = last == [(time, end)]
        last[:] = [(time, end)]
        if not time <= 0.37 < end:
            return new
        if again:
            raise StepDiscarded("b", time, "the slave stays where it was")
        return new + 1.0  # far from what was taken for it: another iteration follows

    monkeypatch.setattr(compiled.library, "loaded", lambda: None)
    monkeypatch.setattr(HermiteStepper, "_iterated", discarded)
    coupling = Hermite(jumps="pass")
    result = simulate(loop({"a": 1.0}), stop_time=1.0, tolerance=1e-6, coupling=coupling)
    assert result.status is Status.SLAVE_FAILED
    assert "stays where it was" in result.message
    assert result.time[-1] <= 0.37


def test_an_fmu_that_discards_every_step_ends_the_run(fmus):
    system = System((Component("f", fmus / "TestFaulty.fmu", {"mode": 1.0, "at": 0.5}),))
    result = simulate(system, stop_time=1.0, tolerance=1e-4, coupling="hermite")
    assert result.status is Status.SLAVE_FAILED
    assert "100% open" in result.message
    assert result.time[-1] == pytest.approx(0.5, abs=1e-12)


def test_a_jump_that_nobody_announces_is_a_status(fmus):
    """y becomes nan at t = 0.5 without notice: no step over it is ever small enough."""
    system = System((Component("f", fmus / "TestFaulty.fmu", {"mode": 3.0, "at": 0.5}),))
    result = simulate(system, stop_time=1.0, tolerance=1e-4, coupling="hermite", record=["f.y"])
    assert result.status is Status.NON_FINITE
    assert "f.y" in result.message
    assert np.isfinite(result.values).all()


def test_an_error_that_never_falls_names_the_connection(loop, monkeypatch):
    from congelation.cosim.coupling import hermite

    def never_falls(piece, points, end, new, *, high, jumps):
        return np.ones(new.shape[1]), None

    monkeypatch.setattr(compiled.library, "loaded", lambda: None)
    monkeypatch.setattr(hermite, "estimated_error", never_falls)
    result = simulate(loop(), stop_time=1.0, tolerance=1e-4, coupling="hermite")
    assert result.status is Status.STEP_TOO_SMALL
    assert " -> " in result.message
    assert result.time.tolist() == [0.0]


def test_iterations_that_never_settle_name_the_connection(loop, monkeypatch):
    from congelation.cosim.coupling import hermite

    found = hermite.HermiteStepper._iterated
    sizes = itertools.cycle([1.0, -1.0])

    def restless(self, *arguments):
        return found(self, *arguments) + next(sizes)

    monkeypatch.setattr(compiled.library, "loaded", lambda: None)
    monkeypatch.setattr(hermite.HermiteStepper, "_iterated", restless)
    result = simulate(loop(), stop_time=1.0, tolerance=1e-4, coupling="hermite")
    assert result.status is Status.NOT_CONVERGED
    assert "controller.u -> plant.u" in result.message


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"step": 0.1, "coupling": "hermite"}, "'hermite' \\(steps are repeated\\)"),
        ({"tolerance": 1e-3, "coupling": "derivative"}, "a tolerance \\(steps are taken back\\)"),
    ],
)
def test_fmus_without_states_get_a_clear_message(fmus, kwargs, message):
    system = System((Component("p", fmus / "TestPlainPlant.fmu"),))
    with pytest.raises(InvalidInput, match=message) as caught:
        simulate(system, stop_time=1.0, **kwargs)
    assert "component 'p'" in str(caught.value)
    assert "fixed step" in str(caught.value)


# -- systems in which not every FMU has der(.) --------------------------------------------------


def mixed(fmus):
    """A plant with held inputs, no output derivatives and no declared dependencies."""
    return System(
        (
            Component("plant", fmus / "TestPlainPlant.fmu"),
            Component("controller", fmus / "TestController.fmu"),
        ),
        (Connection("plant.x", "controller.x"), Connection("controller.u", "plant.u")),
    )


def from_rest(times):
    return solution(times, x0=(1.0, 0.0))


@pytest.mark.parametrize("sequence", ["gauss_seidel", "jacobi"])
def test_derivative_coupling_with_an_fmu_that_holds_its_inputs(fmus, sequence):
    steps = (0.04, 0.02, 0.01)
    errors = [
        error(
            mixed(fmus), from_rest, coupling="derivative", options={"sequence": sequence}, step=h
        )[0]
        for h in steps
    ]
    assert order(steps, errors) == pytest.approx(2.0, abs=0.3)


def test_one_hermite_iteration_with_an_fmu_that_holds_its_inputs_is_of_order_two(fmus):
    """The held input is the mean of its cubic over the step, not its first value."""
    steps = (0.08, 0.04, 0.02)
    errors = [
        error(mixed(fmus), from_rest, coupling=Hermite(iterations=1), step=h)[0] for h in steps
    ]
    assert order(steps, errors) == pytest.approx(2.0, abs=0.3)


# -- feedthrough and algebraic loops ------------------------------------------------------------


def ring(fmus, first, second):
    file = fmus / "TestGain.fmu"
    return System(
        (Component("a", file, first), Component("b", file, second)),
        (Connection("a.y", "b.u"), Connection("b.y", "a.u")),
    )


@pytest.mark.parametrize("coupling", ["jacobi", "derivative", "hermite"])
@pytest.mark.parametrize("gain", [0.5, -0.9, -20.0, 3.0])
def test_linear_loops_are_solved(fmus, coupling, gain):
    result = simulate(
        ring(fmus, {"k": gain, "b": 1.0}, {}),
        stop_time=0.2,
        step=0.1,
        coupling=coupling,
        record=["a.y", "b.y"],
    )
    assert result.completed, result.message
    assert result.values[0] == pytest.approx(1.0 / (1.0 - gain), rel=1e-9)
    if coupling != "jacobi":
        assert result.values == pytest.approx(1.0 / (1.0 - gain), rel=1e-8)


def test_a_nonlinear_loop_is_solved(fmus):
    """y = 0.5 y - y^3 + 1."""
    result = simulate(
        ring(fmus, {"k": 0.5, "c": -1.0, "b": 1.0}, {}), stop_time=0.1, step=0.1, record=["a.y"]
    )
    y = result.values[0, 0]
    assert 0.5 * y - y**3 + 1.0 == pytest.approx(y, abs=1e-9)


def test_a_loop_without_solution_is_named(fmus):
    """y = y + 1 has none."""
    result = simulate(ring(fmus, {"b": 1.0}, {}), stop_time=0.1, step=0.1)
    assert result.status is Status.LOOP_UNSOLVED
    assert "a.y -> b.u" in result.message
    assert "b.y -> a.u" in result.message


def test_feedthrough_is_followed_in_the_order_of_the_dependencies(fmus, loop):
    """A chain of gains, declared backwards, between plant and controller."""
    gain = fmus / "TestGain.fmu"
    system = System(
        (
            Component("second", gain, {"k": 4.0}),
            Component("first", gain, {"k": 0.25}),
            *loop().components,
        ),
        (
            Connection("plant.x", "controller.x"),
            Connection("controller.u", "first.u"),
            Connection("first.y", "second.u"),
            Connection("second.y", "plant.u"),
        ),
    )
    result = simulate(
        system,
        stop_time=3.0,
        step=0.05,
        coupling="hermite",
        record=[*RECORD, "controller.u", "second.y"],
    )
    assert result.completed, result.message
    assert result.values[0, 3] == result.values[0, 4] == -2.8
    assert np.abs(result.values[:, :3] - solution(result.time)).max() < 1e-6


def test_undeclared_dependencies_do_not_hinder(fmus):
    result = simulate(
        mixed(fmus), stop_time=0.1, step=0.1, coupling="jacobi", record=["controller.u", "plant.u"]
    )
    assert result.values[0].tolist() == [-2.3, -2.3]
