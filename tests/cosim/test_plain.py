"""FMUs as most tools write them: inputs are held, derivatives unknown, a tolerance kept."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from congelation.cosim import Component, Connection, SlavePool, Status, System, simulate
from congelation.cosim.recording import Output

from .c_fmus import SOURCES, plain_fmu, truck_fmu
from .monolithic import order

STIFFNESS, MASS, SPEED = 1e5, 100.0, 0.1


class Linear:
    """A system of plain FMUs whose recorded variables y are those of z' = A z.

    The FMU of each component is x' = a x + b1 u1 + b2 u2, y = x + d1 u1 + d2 u2.
    """

    def __init__(self, parts, links, A, z0, outputs, stop):
        self.parts, self.links, self.stop = parts, links, stop
        self.A, self.z0 = np.array(A, float), np.array(z0, float)
        self.outputs = {name: np.array(row, float) for name, row in outputs.items()}

    def system(self, passing, declaring):
        """Components that pass inputs on at once use the FMU `passing`, the others `declaring`."""
        return System(
            tuple(
                Component(name, passing if {"d1", "d2"} & start.keys() else declaring, start)
                for name, start in self.parts.items()
            ),
            tuple(Connection.parse(link) for link in self.links),
        )

    def solution(self, times):
        """The recorded variables, shape (N, n)."""
        z = np.array([expm(self.A * t) @ self.z0 for t in times])
        return z @ np.array(list(self.outputs.values())).T


SPRING = Linear(
    {
        "mass": {"b1": 1.0 / MASS, "x0": SPEED},
        "spring": {"b1": 1.0},
        "force": {"d1": -STIFFNESS},
    },
    ["mass.y -> spring.u1", "spring.y -> force.u1", "force.y -> mass.u1"],
    [[0.0, -STIFFNESS / MASS], [1.0, 0.0]],
    [SPEED, 0.0],
    {"mass.y": [1, 0], "spring.y": [0, 1], "force.y": [0, -STIFFNESS]},
    1.0,
)

TWO_MASSES = Linear(
    {
        "v1": {"a": -0.4, "b1": 1.0},
        "x1": {"b1": 1.0, "x0": 1.0},
        "v2": {"a": -0.2, "b1": 1.0},
        "x2": {"b1": 1.0},
        "f1": {"d1": -6.0, "d2": 2.0},
        "f2": {"d1": 4.0, "d2": -4.0},
    },
    [
        "v1.y -> x1.u1",
        "v2.y -> x2.u1",
        "x1.y -> f1.u1",
        "x2.y -> f1.u2",
        "x1.y -> f2.u1",
        "x2.y -> f2.u2",
        "f1.y -> v1.u1",
        "f2.y -> v2.u1",
    ],
    [[0, 1, 0, 0], [-6, -0.4, 2, 0], [0, 0, 0, 1], [4, 0, -4, -0.2]],
    [1.0, 0.0, 0.0, 0.0],
    {"x1.y": [1, 0, 0, 0], "v1.y": [0, 1, 0, 0], "x2.y": [0, 0, 1, 0], "v2.y": [0, 0, 0, 1]},
    10.0,
)

CHAIN = Linear(
    {"c": {"b1": 1.0}, "b": {"b1": 1.0}, "a": {"a": -1.0, "x0": 1.0}},
    ["a.y -> b.u1", "b.y -> c.u1"],
    [[-1, 0, 0], [1, 0, 0], [0, 1, 0]],
    [1.0, 0.0, 0.0],
    {"a.y": [1, 0, 0], "b.y": [0, 1, 0], "c.y": [0, 0, 1]},
    10.0,
)

FAST_AND_SLOW = Linear(
    {"fast": {"a": -200.0, "b1": 200.0}, "slow": {"a": -1.0, "b1": -5.0, "x0": 1.0}},
    ["slow.y -> fast.u1", "fast.y -> slow.u1"],
    [[-200, 200], [-5, -1]],
    [0.0, 1.0],
    {"fast.y": [1, 0], "slow.y": [0, 1]},
    5.0,
)

SYSTEMS = {
    "spring": SPRING,
    "two masses": TWO_MASSES,
    "chain": CHAIN,
    "fast and slow": FAST_AND_SLOW,
}


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    """The FMU without declared dependencies, and the one that declares that there are none."""
    folder = tmp_path_factory.mktemp("plain")
    return plain_fmu(folder), plain_fmu(folder, declares=True)


def run(linear, fmus, **kwargs):
    """The largest error of any variable relative to its peak, and the result."""
    system = linear.system(*fmus)
    result = simulate(system, stop_time=linear.stop, record=list(linear.outputs), **kwargs)
    assert result.completed, result.message
    exact = linear.solution(result.time)
    errors = np.abs(result.values - exact).max(axis=0) / np.abs(exact).max(axis=0)
    return errors.max(), result


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("coupling", ["hermite", "derivative"])
@pytest.mark.parametrize("name", SYSTEMS)
def test_the_error_is_within_ten_times_the_tolerance(fmus, name, coupling, tolerance):
    error, result = run(SYSTEMS[name], fmus, coupling=coupling, tolerance=tolerance)
    assert error < 10.0 * tolerance
    assert result.statistics.estimated_error <= tolerance


@pytest.mark.parametrize("coupling", ["hermite", "derivative"])
def test_without_declared_dependencies_the_error_is_as_small(fmus, coupling):
    passing, _ = fmus
    error, _ = run(SPRING, (passing, passing), coupling=coupling, tolerance=1e-3)
    assert error < 1e-2


def quarter_truck(time, z):
    """z' of the chassis and the wheel of truck.c: position and velocity of each."""
    chassis, speed, wheel, wheel_speed = z
    between = 15e3 * (wheel - chassis) + 1e3 * (wheel_speed - speed)
    road = 150e3 * (0.1 - wheel) - 0.5 * wheel_speed
    return [speed, between / 400, wheel_speed, (road - between) / 40]


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("coupling", ["hermite", "derivative", "auto"])
def test_a_stiff_pair_that_solves_itself_takes_few_steps(tmp_path, coupling, tolerance):
    """A spring and damper between chassis and wheel: 15 kN at the start, which calm down."""
    fmu = truck_fmu(tmp_path)
    parts = (Component("chassis", fmu), Component("wheel", fmu, {"part": 1.0}))
    links = ("chassis.velocity -> wheel.in", "wheel.force -> chassis.in")
    system = System(parts, tuple(map(Connection.parse, links)))
    recorded = [
        f"{part}.{name}" for part in ("chassis", "wheel") for name in ("position", "velocity")
    ]
    recorded += ["chassis.acceleration", "wheel.acceleration"]
    result = simulate(
        system, stop_time=1.0, record=recorded, coupling=coupling, tolerance=tolerance
    )
    z = solve_ivp(
        quarter_truck, (0.0, 1.0), np.zeros(4), "DOP853", result.time, rtol=1e-10, atol=1e-12
    ).y
    rates = quarter_truck(result.time, z)
    exact = np.column_stack([*z, rates[1], rates[3]])
    errors = np.abs(result.values - exact)[1:].max(axis=0) / np.abs(exact).max(axis=0)
    # Inputs that are predicted show nothing of an output that is late by an inner step.
    assert errors[: 4 if coupling == "auto" else 6].max() < 10.0 * tolerance
    assert tolerance < 1e-3 or result.statistics.macro_steps <= 2000


@pytest.mark.parametrize(("coupling", "steps"), [("hermite", 200), ("derivative", 800)])
def test_a_force_that_grows_from_zero_takes_few_steps(fmus, coupling, steps):
    """F(0) = 0 grows to 316 N; five periods of the spring in 1 s."""
    _, result = run(SPRING, fmus, coupling=coupling, tolerance=1e-3)
    assert result.statistics.macro_steps < steps
    assert np.abs(result.column("force.y")).max() == pytest.approx(316.2, rel=2e-2)


@pytest.mark.parametrize("coupling", ["hermite", "derivative"])
def test_the_first_step_is_judged_too(fmus, coupling):
    """Tried much too long at the start, it is taken back."""
    error, result = run(TWO_MASSES, fmus, coupling=coupling, tolerance=1e-3, step=5.0)
    assert result.statistics.rejected >= 1
    assert result.time[1] < 1.0
    assert error < 1e-2


@pytest.mark.parametrize("name", ["spring", "two masses", "chain"])
@pytest.mark.parametrize("count", [100, 400, 1600])
def test_derivative_is_never_worse_than_gauss_seidel(fmus, name, count):
    linear = SYSTEMS[name]
    errors = [
        run(linear, fmus, coupling=coupling, step=linear.stop / count)[0]
        for coupling in ("derivative", "gauss_seidel")
    ]
    assert errors[0] < errors[1]


@pytest.mark.parametrize("coupling", ["hermite", "derivative"])
def test_held_at_their_mean_inputs_are_of_order_two(fmus, coupling):
    counts = np.array([200, 400, 800])
    steps = TWO_MASSES.stop / counts
    errors = [run(TWO_MASSES, fmus, coupling=coupling, step=h)[0] for h in steps]
    assert order(steps, errors) == pytest.approx(2.0, abs=0.3)


@pytest.mark.parametrize("coupling", ["hermite", "derivative"])
def test_the_accuracy_of_the_fmus_is_a_floor_that_is_told(fmus, coupling):
    """Outputs rounded to multiples of 1e-3, at a tolerance of 1e-3 over 10 s."""
    parts = {name: {**start, "grain": 1e-3} for name, start in TWO_MASSES.parts.items()}
    rough = Linear(
        parts, TWO_MASSES.links, TWO_MASSES.A, TWO_MASSES.z0, TWO_MASSES.outputs, TWO_MASSES.stop
    )
    error, result = run(rough, fmus, coupling=coupling, tolerance=1e-3)
    assert result.statistics.floors > 0
    assert "the accuracy of the FMUs, not the step, limited the error" in result.message
    assert error < 2e-2
    assert result.statistics.macro_steps < 5000


def test_a_completed_run_is_terminated_and_an_instance_reset_only_for_the_next(
    fmus, tmp_path, monkeypatch
):
    notes = tmp_path / "notes"
    notes.touch()
    monkeypatch.setenv("PLAIN_FMU_NOTES", str(notes))
    system = System((Component("a", fmus[0]),))
    with SlavePool() as pool:
        assert simulate(system, stop_time=1.0, step=0.5, pool=pool).completed
        assert notes.read_text() == ""
        assert simulate(system, stop_time=1.0, step=0.5, pool=pool).completed
        # The second reset follows the comparison with a new instance.
        assert notes.read_text() == "TRR"
    assert notes.read_text() == "TRRT"


@pytest.mark.parametrize("left", ["*m = before;", "m->x = 0.0;"], ids=["nothing", "states"])
def test_an_fmu_whose_reset_is_incomplete_is_instantiated_anew(tmp_path, left):
    """x' = u1: a run with u1 = 5, and two with the default 0."""
    source = (SOURCES / "plain.c").read_text()
    reset = "*m = (Model){.callbacks = m->callbacks};"
    (tmp_path / "plain.c").write_text(
        source.replace(reset, "Model before = *m; (void)before; " + left)
    )
    fmu = plain_fmu(tmp_path, source=tmp_path / "plain.c")
    five = System((Component("a", fmu, {"u1": 5.0, "b1": 1.0, "x0": 1.0}),))
    plain = System((Component("a", fmu, {"b1": 1.0}),))
    with SlavePool() as pool:
        results = [
            simulate(system, stop_time=1.0, step=0.5, record=["a.y"], pool=pool)
            for system in (five, plain, plain)
        ]
    assert [r.values[:, 0].tolist() for r in results] == [[1.0, 3.5, 6.0], [0.0] * 3, [0.0] * 3]
    named = "is instantiated anew for each run, as fmi2Reset does not make it as new: "
    assert [named in r.message for r in results] == [False, True, True]


def test_a_trial_leaves_nothing_behind_where_reset_is_incomplete(tmp_path):
    """Two integrators, x' = y, y' = x, from 1: both are e^t. The pool is lent to trial and run."""
    source = (SOURCES / "plain.c").read_text()
    assert source.count("*m = (Model)") == 1
    (tmp_path / "plain.c").write_text(source.replace("*m = (Model)", "(void)(Model)"))
    fmu = plain_fmu(tmp_path, declares=True, source=tmp_path / "plain.c")
    start = {"b1": 1.0, "x0": 1.0}
    system = System(
        (Component("a", fmu, start), Component("b", fmu, start)),
        (Connection("a.y", "b.u1"), Connection("b.y", "a.u1")),
    )
    with SlavePool() as pool:
        for _ in range(2):
            result = simulate(system, stop_time=1.0, step=0.01, record=["a.y"], pool=pool)
            assert result.values[0, 0] == 1.0
            assert result.values[-1, 0] == pytest.approx(np.e, rel=1e-4)


@pytest.mark.parametrize(
    "kwargs",
    [
        {"step": 0.25, "coupling": "jacobi"},
        {"step": 0.25, "coupling": "derivative"},
        {"tolerance": 1e-3, "coupling": "hermite", "step": 0.25},
    ],
)
def test_an_fmu_may_end_the_run(fmus, kwargs):
    system = System((Component("a", fmus[0], {"a": -1.0, "x0": 1.0, "ends": 0.6}),))
    result = simulate(system, stop_time=1.0, record=["a.y"], **kwargs)
    assert result.status is Status.TERMINATED
    assert result.message.startswith("a at t = 0.")
    assert result.message.endswith("ended the run: it gave no reason")
    assert 0.5 <= result.time[-1] <= 0.6
    assert result.values[-1, 0] == pytest.approx(np.exp(-result.time[-1]), rel=1e-12)
    assert result.whole
    assert not result.completed


@pytest.mark.parametrize(
    ("status", "end"),
    [
        ("Discard", " (where the step is fixed: give a smaller one, or a tolerance)"),
        ("Pending", "; FMUs whose steps end later than the call are not run"),
    ],
)
def test_what_helps_where_a_step_is_refused_without_a_reason(tmp_path, status, end):
    source = (SOURCES / "plain.c").read_text()
    refused = source.replace(
        "    if (t + h > 0.5) {", f"    if (h > 0.05) return fmi2{status};\n{{"
    )
    assert refused != source
    (tmp_path / "plain.c").write_text(refused)
    system = System((Component("a", plain_fmu(tmp_path, source=tmp_path / "plain.c")),))
    result = simulate(system, stop_time=0.2, step=0.1, coupling="jacobi")
    assert result.message == f"a at t = 0: fmi2DoStep returned fmi2{status}{end}"


@pytest.mark.parametrize(
    ("size", "kwargs", "warns"),
    [
        (1e-6, {"tolerance": 1e-3, "coupling": "auto"}, True),
        (1e-6, {"tolerance": 1e-3, "coupling": "hermite"}, True),
        (-1e-12, {"tolerance": 1e-3, "coupling": "derivative"}, True),
        (1e-6, {"tolerance": 1e-3, "output": Output(interval=0.1)}, True),
        # Errors are resolved, the size is not known, or nothing moves.
        (2e-3, {"tolerance": 1e-3}, False),
        (1e-6, {"tolerance": 1e-9, "coupling": "hermite"}, False),
        (1e-6, {"step": 0.01}, False),
        (0.0, {"tolerance": 1e-3}, False),
        (1e-6, {"tolerance": 1e-3, "record": ["p.y"]}, False),
        (1e-6, {"tolerance": 1e-3, "output": Output(interval=1.0)}, False),
    ],
)
def test_values_that_are_too_small_for_the_tolerance_are_named(fmus, size, kwargs, warns):
    """An oscillator whose size no nominal value states, x'' = -x."""
    parts = (
        Component("p", fmus[1], {"x0": size, "b1": 1.0}),
        Component("q", fmus[1], {"b1": -1.0}),
    )
    result = simulate(System(parts, ("p.y -> q.u1", "q.y -> p.u1")), stop_time=10.0, **kwargs)
    assert result.completed
    said = "Every connected value stays below tolerance x nominal value, so that errors as large"
    assert (said in result.message) is warns
    if size == 1e-6 and warns:
        assert result.message.endswith("or give a tolerance below 1e-09.")
    if not warns and kwargs.get("tolerance") == 1e-9:
        exact = size * np.column_stack([np.cos(result.time), -np.sin(result.time)])
        assert abs(result.values - exact).max() < 1e-2 * abs(size)
