"""What a tolerance promises of values that no input sees, and of those that follow from discrete
ones."""

import numpy as np
import pytest

from congelation.cosim import Component, Connection, Output, Status, System, simulate, stepping

from .c_fmus import SOURCES, early_fmu, plain_fmu, signals_fmu

TOLERANCE = 1e-4


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    return signals_fmu(tmp_path_factory.mktemp("signals"))


def system(fmu, *links, **starts):
    """A source s, and an integrator i that listens to it."""
    parts = tuple(Component(name, fmu, starts.get(name, {})) for name in "si")
    return System(parts, tuple(Connection.parse(link) for link in links))


@pytest.mark.parametrize("w", [5.0, 20.0])
@pytest.mark.parametrize("coupling", ["derivative", "hermite"])
def test_an_integrator_at_the_end_of_a_chain_is_as_accurate_as_the_tolerance_says(
    fmu, coupling, w, monkeypatch
):
    """x' = -x + sin(w t), by both loops."""
    T = 2.0
    exact = (w * np.exp(-T) + np.sin(w * T) - w * np.cos(w * T)) / (1.0 + w * w)
    connected = system(fmu, "s.s -> i.u", s={"w": w}, i={"a": -1.0})
    wanted = {"tolerance": TOLERANCE, "coupling": coupling, "record": ["i.x"]}
    result = simulate(connected, stop_time=T, **wanted)
    assert result.status is Status.COMPLETED
    assert abs(result.values[-1, 0] - exact) < 10.0 * TOLERANCE
    assert result.statistics.estimated_error > 0.0
    assert result.statistics.macro_steps < 5000
    monkeypatch.setattr(stepping, "available", lambda: False)
    again = simulate(connected, stop_time=T, **wanted)
    assert again.time.tolist() == result.time.tolist()
    assert again.values.tolist() == result.values.tolist()


@pytest.mark.parametrize("coupling", ["auto", "derivative", "hermite"])
def test_a_pulse_after_rest_that_nobody_announces_is_seen(fmu, coupling):
    """x' = the pulse, in a tenth of the time."""
    result = simulate(
        system(fmu, "s.s -> i.u", s={"fault": 3.0}),
        stop_time=10.0,
        tolerance=TOLERANCE,
        coupling=coupling,
        record=["i.x"],
    )
    assert result.status is Status.COMPLETED
    assert result.values[-1, 0] == pytest.approx(1.0, abs=10.0 * TOLERANCE)


def triangle(t):
    """Of period 0.4 s, between -0.1 and 0.1: x' = 1 until x > 0.1, then -1 until x < -0.1."""
    phase = (t + 0.1) % 0.4
    return np.where(phase < 0.2, phase - 0.1, 0.3 - phase)


def bounces(t):
    """The height of a ball that falls from 1 m, and bounces with 0.8 of its speed."""
    x, start, speed, g = np.zeros_like(t), 0.0, 0.0, 9.81
    height = 1.0
    while start < t[-1]:
        s = t - start
        end = (speed + np.sqrt(speed**2 + 2.0 * g * height)) / g
        at = (s >= 0.0) & (s < end)
        x[at] = (height + speed * s - g * s**2 / 2.0)[at]
        start, speed, height = start + end, 0.8 * (g * end - speed), 0.0
    return x


RELAY = (4.0, ("s.s -> i.u", "i.x -> s.u"), "i.x", triangle, 2.9)
BALL = (5.0, ("s.x -> i.u",), "s.x", bounces, 1.9)


@pytest.mark.parametrize("order", ["si", "is"])
@pytest.mark.parametrize(
    ("fault", "links", "judged", "exact", "T", "coupling"),
    # Iterations of `hermite` do not settle where a relay in a loop switches.
    [(*RELAY, name) for name in ("auto", "derivative")]
    + [(*BALL, name) for name in ("auto", "derivative", "hermite")],
)
def test_jumps_that_an_fmu_makes_when_its_next_step_begins_are_located(
    fmu, order, fault, links, judged, exact, T, coupling, monkeypatch
):
    """Of a value, and of a slope; in whatever order the components stand."""
    both = system(fmu, *links, s={"fault": fault})
    connected = System(tuple(sorted(both.components, key=lambda c: order.index(c.name))), links)
    wanted = {"stop_time": T, "tolerance": 1e-3, "coupling": coupling, "record": [judged]}
    result = simulate(connected, **wanted)
    assert result.status is Status.COMPLETED
    off = np.abs(result.values[:, 0] - exact(result.time))
    assert off.max() < 10.0 * 1e-3
    monkeypatch.setattr(stepping, "available", lambda: False)
    again = simulate(connected, **wanted)
    assert again.time.tolist() == result.time.tolist()
    assert again.values.tolist() == result.values.tolist()
    bands = simulate(connected, trust=True, **wanted).column(f"error({judged})")
    assert bands.max() >= off.max()


@pytest.mark.parametrize("coupling", ["auto", "derivative", "hermite"])
@pytest.mark.parametrize(
    ("link", "T", "exact", "jumps"),
    [
        ("s.on -> i.switch", 1.0, 1.0 - 0.3337, 1),
        ("s.count -> i.level", 1.0, 4.5, 10),
        ("s.held -> i.u", 0.95, sum(np.sin(0.5 * k) for k in range(9)) / 10.0, 9),
    ],
)
def test_changes_of_discrete_values_are_located(fmu, coupling, link, T, exact, jumps):
    """x' = the value, x(0) = 0; the last one of `held` counts half."""
    if link.startswith("s.held"):
        exact += 0.05 * np.sin(0.5 * 9)
    result = simulate(
        system(fmu, link),
        stop_time=T,
        tolerance=TOLERANCE,
        coupling=coupling,
        record=["i.x"],
    )
    assert result.status is Status.COMPLETED
    assert result.values[-1, 0] == pytest.approx(exact, abs=TOLERANCE)
    assert result.statistics.events == jumps
    assert 0.0 < result.statistics.estimated_error <= TOLERANCE
    assert result.statistics.macro_steps < 600


@pytest.mark.parametrize("coupling", ["auto", "jacobi", "derivative", "hermite"])
def test_a_discrete_real_is_held_at_a_fixed_step(fmu, coupling):
    """x' = -x + held: exact at the samples of the source."""
    result = simulate(
        system(fmu, "s.held -> i.u", i={"a": -1.0}),
        stop_time=2.0,
        step=0.1,
        coupling=coupling,
        record=["i.x"],
    )
    x, decay = 0.0, np.exp(-0.1)
    for k in range(20):
        x = decay * x + (1.0 - decay) * np.sin(0.5 * k)
    assert result.values[-1, 0] == pytest.approx(x, abs=1e-12)


def test_a_recorded_value_with_a_derivative_that_no_input_sees_is_resolved(fmu):
    """cos(50 t) beside sin t, on a grid."""
    result = simulate(
        system(fmu, "s.s -> i.u", i={"a": -1.0}),
        stop_time=2.0,
        tolerance=TOLERANCE,
        coupling="hermite",
        record=["s.z"],
        output=Output(interval=0.01),
    )
    assert np.abs(result.values[:, 0] - np.cos(50.0 * result.time)).max() < 1e-3


def test_what_auto_says_where_no_real_values_are_exchanged(fmu):
    options = {"stop_time": 1.0, "tolerance": TOLERANCE}
    assert simulate(system(fmu), **options).choice == "auto: derivative, as nothing is connected"
    assert simulate(system(fmu, "s.on -> i.switch"), **options).choice == (
        "auto: derivative, as all values that are exchanged are discrete"
    )


def test_a_tolerance_that_fixed_steps_do_not_keep_is_named(tmp_path):
    result = simulate(
        system(signals_fmu(tmp_path, fixed=True), "s.s -> i.u"), stop_time=1.0, tolerance=TOLERANCE
    )
    assert result.status is Status.COMPLETED
    assert "The tolerance of 0.0001 is not kept" in result.message


def test_a_derivative_that_is_no_number_is_named(fmu):
    """Rather than a loop that has no solution."""
    result = simulate(
        system(fmu, "s.z -> i.u", s={"fault": 1.0}), stop_time=1.0, step=0.1, coupling="derivative"
    )
    assert result.status is Status.NON_FINITE
    assert result.message == "s.der(z) at t = 0 is nan"


def test_states_without_the_time_are_told_from_steps_of_one_length(fmu):
    """x' = -x + sin t, from an FMU that refuses a step from its restored state."""
    connected = system(fmu, "s.s -> i.u", s={"fault": 2.0}, i={"a": -1.0})
    result = simulate(connected, stop_time=1.0, tolerance=TOLERANCE, record=["i.x"])
    assert result.status is Status.COMPLETED
    assert (
        "s declares states that can be saved and restored, but steps from a restored one are "
        "refused"
    ) in result.choice
    exact = (np.exp(-1.0) + np.sin(1.0) - np.cos(1.0)) / 2.0
    assert result.values[-1, 0] == pytest.approx(exact, abs=10.0 * TOLERANCE)


@pytest.mark.parametrize(
    "options",
    [
        {"tolerance": TOLERANCE, "coupling": "derivative"},
        {"tolerance": TOLERANCE, "coupling": "hermite"},
        {"step": 0.1, "coupling": "hermite"},
    ],
)
def test_states_that_are_not_restored_end_the_run_of_a_coupling_that_needs_them(tmp_path, options):
    """x' = y, y' = x, from FMUs whose fmi2SetFMUstate does nothing."""
    rest = (SOURCES / "rest.h").read_text()
    (tmp_path / "rest.h").write_text(rest.replace("memcpy(c, state, sizeof(Model));", ""))
    (tmp_path / "plain.c").write_text((SOURCES / "plain.c").read_text())
    forgetful = plain_fmu(tmp_path, declares=True, source=tmp_path / "plain.c")
    start = {"b1": 1.0, "x0": 1.0}
    loop = System(
        (Component("a", forgetful, start), Component("b", forgetful, start)),
        (Connection("a.y", "b.u1"), Connection("b.y", "a.u1")),
    )
    result = simulate(loop, stop_time=1.0, **options)
    assert result.status is Status.SLAVE_FAILED
    assert "a at t = 0: it declares states that can be saved and restored, but" in result.message
    chosen = simulate(loop, stop_time=1.0, tolerance=TOLERANCE, record=["a.y"])
    assert chosen.completed
    assert chosen.values[-1, 0] == pytest.approx(np.e, rel=1e-2)


@pytest.mark.parametrize("coupling", ["auto", "derivative", "hermite"])
@pytest.mark.parametrize("steps", [{"step": 0.1}, {"tolerance": TOLERANCE}])
def test_a_source_that_jumps_a_little_before_the_time_it_announces(
    tmp_path, coupling, steps, monkeypatch
):
    """x' = y, x(0) = 1, where y jumps to 1 at 0.35: by both loops."""
    source = Component("s", early_fmu(tmp_path), {"at": 0.35, "margin": 1e-12})
    sink = Component("i", plain_fmu(tmp_path, declares=True), {"b1": 1.0, "x0": 1.0})
    connected = System((source, sink), (Connection.parse("s.y -> i.u1"),))
    wanted = {"stop_time": 1.0, "coupling": coupling, "record": ["s.y", "i.y"], **steps}
    result = simulate(connected, **wanted)
    assert result.status is Status.COMPLETED
    assert result.values[-1, 1] == pytest.approx(1.65, abs=1e-11)
    assert np.array_equal(result.values[:, 0], result.time >= 0.35)
    assert 0.35 in result.time
    monkeypatch.setattr(stepping, "available", lambda: False)
    again = simulate(connected, **wanted)
    assert again.time.tolist() == result.time.tolist()
    assert again.values.tolist() == result.values.tolist()
