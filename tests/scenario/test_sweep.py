"""Designs of experiments: the points of a sweep, and what a scenario says of them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from congelation.errors import InvalidInput
from congelation.results.record import Outcome
from congelation.scenario.axes import DISTRIBUTIONS, SAMPLINGS, RandomAxis, Sweep
from congelation.scenario.load import load_scenario
from congelation.sweep.plan import plan_study
from tests.scenarios import ROOT, SCALAR, write

SWEEP = """
[sweep]
sampling = "latin_hypercube"
samples = 4
seed = 7

[[sweep.axes]]
set = "controller.epsilon"
log_uniform = [0.1, 1.0]

[[sweep.axes]]
set = "plant.x0"
uniform = [-2, 2]

[[sweep.axes]]
set = ["experiment.coupling", "experiment.step"]
values = [["jacobi", 0.01], ["derivative", 0.02], ["derivative", 0.01]]

[[sweep.axes]]
set = "controller.gamma"
values = [1, 2]
"""


def sweep_of(folder: Path, *changes: tuple[str, str]) -> Sweep:
    scenario = load_scenario(write(folder, SCALAR + SWEEP, *changes))
    assert scenario.sweep is not None
    return scenario.sweep


def test_lists_are_crossed_with_each_other_and_with_the_sample(tmp_path: Path) -> None:
    sweep = sweep_of(tmp_path)
    points = list(sweep.points())
    assert len(points) == sweep.size == 3 * 2 * 4
    assert list(points[0]) == [
        *("experiment.coupling", "experiment.step", "controller.gamma"),
        *("controller.epsilon", "plant.x0[1]"),
    ]
    crossed = {
        (p["experiment.coupling"], p["experiment.step"], p["controller.gamma"]) for p in points
    }
    assert len(crossed) == 6
    assert len({p["controller.epsilon"] for p in points}) == 4
    assert all(0.1 <= float(p["controller.epsilon"]) <= 1.0 for p in points)


@pytest.mark.parametrize(
    ("axis", "expected"),
    [
        ("linspace = [1, 2, 5]", [1.0, 1.25, 1.5, 1.75, 2.0]),
        ("linspace = [2, -2, 3]", [2.0, 0.0, -2.0]),
        ("logspace = [0.01, 100, 5]", [0.01, 0.1, 1.0, 10.0, 100.0]),
        ("logspace = [1.1, 1.3, 2]", [1.1, 1.3]),
    ],
)
def test_values_may_be_spaced(tmp_path: Path, axis: str, expected: list[float]) -> None:
    for names in ('"plant.x0"', '["plant.x0", "controller.theta_hat0"]'):
        text = f"\n[sweep]\n[[sweep.axes]]\nset = {names}\n{axis}\n"
        sweep = load_scenario(write(tmp_path, SCALAR + text)).sweep
        assert sweep is not None
        points = list(sweep.points())
        for name in sweep.names():
            found = [point[name] for point in points]
            assert found == pytest.approx(expected, rel=1e-14)
            assert (found[0], found[-1]) == (expected[0], expected[-1])


ONLY = """
[sweep]
sampling = "latin_hypercube"
samples = 3
constraints = ["plant.profile.theta[1].square.amplitude < 0.45", "controller.gamma < 3"]

[[sweep.axes]]
set = "plant.profile.theta[1].square.amplitude"
uniform = [0.1, 0.4]

[[sweep.axes]]
set = "controller.k_bar"
uniform = [1, 2]
variants = ["Controller 2"]

[[sweep.axes]]
set = "controller.gamma"
values = [1, 2, 3]
variants = ["Controller 2"]

[[sweep.axes]]
set = "controller.gamma"
values = [0.5, 0.7]
variants = ["Controller 1"]
"""


def test_an_axis_may_be_of_some_variants(tmp_path: Path) -> None:
    third = SCALAR + '\n[[variants]]\nname = "neither"\n'
    scenario = load_scenario(write(tmp_path, third + ONLY))
    plan = plan_study(scenario, tmp_path / "out", swept=True, write=False)
    runs: dict[str, list[dict[str, object]]] = {v.name: [] for v in scenario.variants}
    numbers = []
    for task in plan.tasks():
        numbers.append(task.number)
        runs[task.variant].append(dict(task.settings))
    # Of `neither` there is one run for each draw; the others differ in a gain as well.
    assert {name: len(found) for name, found in runs.items()} == {
        "Controller 1": 6,
        "Controller 2": 6,
        "neither": 3,
    }
    assert plan.total == 15
    assert numbers == sorted(set(numbers))
    again = {task.number: (task.variant, task.run_id) for task in plan.tasks()}
    assert {n: (t.variant, t.run_id) for n in numbers for t in plan.tasks([n])} == again
    amplitude = "plant.profile[1].square[1].amplitude"
    drawn = [{run[amplitude] for run in found} for found in runs.values()]
    assert drawn[0] == drawn[1] == drawn[2]
    assert len(drawn[0]) == 3
    assert {run["controller.gamma"] for run in runs["Controller 2"]} == {1.0, 2.0}
    assert {run["controller.gamma"] for run in runs["Controller 1"]} == {0.5, 0.7}
    assert all(1.0 <= float(str(run["controller.k_bar"])) <= 2.0 for run in runs["Controller 2"])
    for other in ("Controller 1", "neither"):
        assert not any("controller.k_bar" in run for run in runs[other])
    record = plan.record(next(t for t in plan.tasks() if t.variant == "neither"), Outcome("ERROR"))
    assert record.settings["controller.k_bar"] == 0.5  # the scenario's
    assert record.settings["controller.gamma"] is None  # left to the FMU
    assert scenario.sweep is not None
    composed = replace(scenario, file=None, text="").sweep  # read again, from its own document
    assert composed is not None
    assert composed.document() == scenario.sweep.document()


def test_a_grid_is_read_again_from_its_own_document() -> None:
    scenario = load_scenario(ROOT / "scenarios" / "study_rate.toml")
    assert replace(scenario, title="Another").sweep == scenario.sweep


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'variants = ["Controller 1"]',
            'variants = ["Controller 3"]',
            "sweep.axes[4].variants = 'Controller 3' is no variant; did you mean 'Controller",
        ),
        ('variants = ["Controller 1"]', "variants = []", "sweep.axes[4].variants is empty; name"),
        (
            'variants = ["Controller 1"]',
            'variants = ["Controller 1", "Controller 1"]',
            "sweep.axes[4].variants has 'Controller 1' twice; leave one of them out",
        ),
        (
            'variants = ["Controller 1"]',
            'variants = "Controller 1"',
            "sweep.axes[4].variants = 'Controller 1' is not valid; give an array of strings",
        ),
        (
            'variants = ["Controller 1"]',
            'variants = ["Controller 1", "Controller 2"]',
            "sweep.axes[4].set sets 'controller.gamma', which sweep.axes[3] sets already",
        ),
        (
            'set = "controller.gamma"\nvalues = [0.5, 0.7]\nvariants = ["Controller 1"]',
            'set = "controller.gamma"\nvalues = [0.5, 0.7]',
            "sweep.axes[4].set sets 'controller.gamma', which sweep.axes[3] sets already",
        ),
        (
            '"controller.gamma < 3"',
            '"controller.k_bar < controller.epsilon"',
            "'controller.epsilon' is not swept",
        ),
        (
            'set = "controller.gamma"\nvalues = [0.5, 0.7]',
            'set = "controller.epsilon"\nvalues = [0.5, 0.7]',
            "",
        ),
    ],
)
def test_axes_of_no_variant_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    both = ONLY
    if not message:  # a condition on settings of two variants
        both = ONLY.replace('"controller.gamma < 3"', '"controller.gamma < controller.epsilon"')
        message = "sweep.constraints '{}' is of settings that no variant has together".format(
            "controller.gamma < controller.epsilon"
        )
    with pytest.raises(InvalidInput) as told:
        load_scenario(write(tmp_path, SCALAR + both, (old, new)))
    assert message in str(told.value)


def test_equal_seeds_give_equal_points(tmp_path: Path) -> None:
    points = list(sweep_of(tmp_path).points())
    assert list(sweep_of(tmp_path).points()) == points
    assert list(sweep_of(tmp_path, ("seed = 7", "seed = 8")).points()) != points


@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_samplings_fill_the_cube(sampling: str) -> None:
    cube = SAMPLINGS[sampling](256, 3, np.random.default_rng(1))
    assert cube.shape == (256, 3)
    assert np.all((cube >= 0.0) & (cube < 1.0))
    for column in cube.T:
        assert stats.kstest(column, "uniform").pvalue > 0.01


def test_latin_hypercubes_have_one_point_per_stratum() -> None:
    cube = SAMPLINGS["latin_hypercube"](50, 2, np.random.default_rng(1))
    for column in cube.T:
        assert sorted(np.floor(column * 50)) == list(range(50))


def test_sobol_points_balance_every_dyadic_interval() -> None:
    cube = SAMPLINGS["sobol"](64, 3, np.random.default_rng(1))
    for column in cube.T:
        assert sorted(np.floor(column * 64)) == list(range(64))


@pytest.mark.parametrize(
    ("kind", "parameters", "law"),
    [
        ("uniform", (-2.0, 3.0), stats.uniform(-2.0, 5.0)),
        ("log_uniform", (0.1, 10.0), stats.loguniform(0.1, 10.0)),
        ("normal", (1.0, 2.0), stats.norm(1.0, 2.0)),
    ],
)
def test_distributions(kind: str, parameters: tuple[float, float], law: object) -> None:
    axis = RandomAxis("a.b", kind, parameters)
    u = np.linspace(0.001, 0.999, 99)
    assert [axis.value(v) for v in u] == pytest.approx(law.ppf(u), rel=1e-12)  # type: ignore[attr-defined]
    assert math.isfinite(float(axis.value(0.0)))
    assert math.isfinite(float(axis.value(1.0)))


def test_whole_numbers_are_whole_and_equally_frequent() -> None:
    axis = RandomAxis("a.b", "integers", (3.0, 5.0))
    values = [axis.value(u) for u in np.linspace(0.0, 1.0, 301)]
    assert all(isinstance(value, int) for value in values)
    assert {value: values.count(value) for value in set(values)} == pytest.approx(
        {3: 100, 4: 100, 5: 100}, abs=1
    )


MISTAKES = {
    "unknown key": ("samples = 4", "sampels = 4", "sweep.sampels is not known here; did you mean"),
    "no samples": ("samples = 4", "", "sweep.samples is missing; give a whole number"),
    "no whole number of samples": ("samples = 4", "samples = 4.5", "sweep.samples = 4.5 is not"),
    "zero samples": ("samples = 4", "samples = 0", "sweep.samples = 0 is not valid"),
    "unknown sampling": ("latin_hypercube", "latin", "did you mean 'latin_hypercube'?"),
    "Sobol of no power of two": (
        '"latin_hypercube"\nsamples = 4',
        '"sobol"\nsamples = 5',
        "sweep.samples = 5 is not valid; give a power of two for Sobol: 4 or 8",
    ),
    "unknown variable": ("controller.epsilon", "controller.epsilom", "did you mean 'epsilon'?"),
    "unknown component": ("controller.epsilon", "contoller.epsilon", "did you mean 'controller'?"),
    "unknown distribution": (
        "log_uniform",
        "loguniform",
        "sweep.axes[1].loguniform is not known here; did you mean 'log_uniform'?",
    ),
    "two kinds in one axis": (
        "uniform = [-2, 2]",
        "uniform = [-2, 2]\nnormal = [0, 1]",
        "sweep.axes[2].set needs one of: values, linspace, logspace, uniform, "
        "log_uniform, normal, integers",
    ),
    "log of a negative number": (
        "[0.1, 1.0]",
        "[-0.1, 1.0]",
        "sweep.axes[1].log_uniform = [-0.1, 1.0] is not valid; give [low, high] with 0 < low",
    ),
    "one variable twice": (
        "controller.gamma",
        "controller.epsilon",
        "sweep.axes[4].set sets 'controller.epsilon', which sweep.axes[1] sets already",
    ),
    "one variable twice in one axis": (
        'set = "controller.gamma"\nvalues = [1, 2]',
        'set = ["controller.gamma", "controller.gamma"]\nvalues = [[1, 2]]',
        "sweep.axes[4].set sets 'controller.gamma' twice; leave one of them out",
    ),
    "a variable that variants set": (
        'set = "controller.gamma"\nvalues = [1, 2]',
        'set = "controller.damping"\nvalues = [true, false]',
        "sweep.axes[4].set sets 'controller.damping', which the variant 'Controller 1' sets "
        "already; leave it out there, or name the variants that the axis is of: variants = [..]",
    ),
    "row of another length": (
        '["jacobi", 0.01]',
        '["jacobi"]',
        "sweep.axes[3].values[1] is not valid; give 2 values",
    ),
    "value that is not valid": (
        '"jacobi"',
        '"jakobi"',
        "sweep.axes[3].values[1].experiment.coupling = 'jakobi' is not known",
    ),
    "values of no list": ("values = [1, 2]", "values = 1", "sweep.axes[4].values = 1 is not valid"),
    "linspace without a count": (
        "values = [1, 2]",
        "linspace = [1, 2]",
        "sweep.axes[4].linspace = [1, 2] is not valid; give [first, last, count]",
    ),
    "linspace of half a count": (
        "values = [1, 2]",
        "linspace = [1, 2, 2.5]",
        "sweep.axes[4].linspace = [1, 2, 2.5] is not valid",
    ),
    "linspace of one end": (
        "values = [1, 2]",
        "linspace = [1, 1, 3]",
        "sweep.axes[4].linspace = [1, 1, 3] is not valid",
    ),
    "linspace of too many": (
        "values = [1, 2]",
        "linspace = [1, 2, 1000000000]",
        "sweep.axes[4].linspace = [1, 2, 1000000000] is not valid; give [first, last, count] with "
        "two ends and a count from 2 to 1048576",
    ),
    "logspace of a negative end": (
        "values = [1, 2]",
        "logspace = [-1, 2, 3]",
        "sweep.axes[4].logspace = [-1, 2, 3] is not valid; give [first, last, count] with positive",
    ),
    "a spaced value that is not valid": (
        'set = "controller.gamma"\nvalues = [1, 2]',
        'set = "experiment.slave_tolerance"\nlinspace = [0, 0.1, 3]',
        "sweep.axes[4].values[1].experiment.slave_tolerance = 0.0 is not valid",
    ),
    "samples without a random axis": (
        SWEEP,
        '[sweep]\nsamples = 2\n[[sweep.axes]]\nset = "controller.gamma"\nvalues = [1]',
        "sweep.samples has no meaning without a random axis",
    ),
    "more samples than a sweep has": (
        "samples = 4",
        "samples = 1_000_000_000_000",
        "sweep.samples = 1000000000000 is not valid; give a whole number from 1 to 1048576",
    ),
    "more runs than a sweep has": (
        "samples = 4",
        "samples = 1_000_000",
        "sweep has more than 1048576 runs of each variant; split it over several scenarios",
    ),
    "a seed beyond 64 bits": (
        "seed = 7",
        f"seed = {10**60}",
        "... is not valid; give a whole number of at most 64 bits",
    ),
    "no timeout": ("seed = 7", "timeout = 0", "sweep.timeout = 0 is not valid; give a positive"),
    "whole numbers beyond 2^53": (
        "uniform = [-2, 2]",
        "integers = [1, 1e30]",
        "sweep.axes[2].integers = [1, 1e+30] is not valid; give [first, last], whole numbers of at",
    ),
    "ends that are not valid": (
        'set = "plant.x0"',
        'set = "experiment.step"',
        "sweep.axes[2].experiment.step = -1.9999999999999996 is not valid; give a positive time",
    ),
    "infinite draws": (
        "uniform = [-2, 2]",
        "normal = [0, 1e308]",
        "sweep.axes[2].normal = [0, 1e+308] is not valid; give [mean, standard deviation]",
    ),
    "values beyond 64 bits": (
        '[["jacobi", 0.01], ["derivative", 0.02], ["derivative", 0.01]]',
        f'[["jacobi", {10**400}]]',
        "sweep.axes[3].values[1].experiment.step = 1000",
    ),
    "rows beyond 64 bits": (
        'set = "controller.gamma"\nvalues = [1, 2]',
        f'set = "experiment.output_every"\nvalues = [{10**20}]',
        "sweep.axes[4].values[1].experiment.output_every = 100000000000000000000 is not valid",
    ),
    "no axes": (SWEEP, "[sweep]\nsamples = 2", "sweep.axes is missing"),
}


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes_are_told_with_their_place(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    with pytest.raises(InvalidInput) as told:
        sweep_of(tmp_path, (old, new))
    assert str(told.value).startswith(f"{tmp_path / 'loop.toml'}: ")
    assert message in str(told.value)


def test_wide_ranges_do_not_overflow() -> None:
    wide = RandomAxis("a.b", "uniform", (-1e308, 1e308))
    assert [wide.value(u) for u in (0.0, 0.5, 0.75)] == pytest.approx([-1e308, 0.0, 0.5e308])
    decades = RandomAxis("a.b", "log_uniform", (1e-300, 1e300))
    assert [decades.value(u) for u in (0.0, 0.5, 1.0)] == pytest.approx([1e-300, 1.0, 1e300])
    whole = RandomAxis("a.b", "integers", (0.0, 2.0**53))
    assert [whole.value(u) for u in (0.0, 1.0)] == pytest.approx([0, 2**53], abs=2)


def test_a_draw_that_an_experiment_cannot_have_is_told_with_its_axis(tmp_path: Path) -> None:
    axis = '[sweep]\nsamples = 50\n[[sweep.axes]]\nset = "experiment.step"\nnormal = [0.01, 0.01]\n'
    file = write(tmp_path, SCALAR + axis)
    with pytest.raises(InvalidInput) as told:
        plan_study(load_scenario(file), tmp_path / "out", swept=True, write=False)
    assert str(told.value).startswith(f"{file}: experiment.step = -0.0")
    assert str(told.value).endswith("; sweep.axes[1] draws experiment.step (normal)")


def test_every_distribution_is_tested() -> None:
    assert set(DISTRIBUTIONS) == {"uniform", "log_uniform", "normal", "integers"}


@pytest.mark.filterwarnings("error")
def test_spaced_values_past_the_largest_number_are_refused_in_one_line(tmp_path: Path) -> None:
    axis = '\n[sweep]\n[[sweep.axes]]\nset = "plant.x0"\nlinspace = [-1e308, 1e308, 3]\n'
    with pytest.raises(InvalidInput, match=r"nan|inf|finite"):
        load_scenario(write(tmp_path, SCALAR + axis))
