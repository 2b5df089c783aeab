"""The coupling that a run gets where none is stated."""

import shutil
import subprocess
import zipfile
from dataclasses import replace

import fmpy
import numpy as np
import pytest

from benchmarks.coupling import parts as benchmark
from benchmarks.coupling.problems import problem
from congelation.cosim import (
    Component,
    Connection,
    Coupling,
    SlavePool,
    Status,
    System,
    simulate,
)
from congelation.cosim.compiled import library
from congelation.cosim.coupling import Auto
from congelation.cosim.experiment import Experiment
from congelation.errors import InvalidInput
from tests.scenarios import FMUS

from .c_fmus import SOURCES

PLAIN = problem("two_masses_force")


def run(found, folder, ability, **more):
    """The result with no coupling stated, and the largest error of any variable over its peak."""
    result = simulate(
        found.system(folder, ability), stop_time=found.stop, record=found.record, **more
    )
    assert result.completed, result.message
    rows = slice(None, None, max(1, len(result.time) // 100))
    exact = found.exact(result.time[rows])
    values = result.values[rows, : len(found.record)]
    return result, float((np.abs(values - exact).max(axis=0) / np.abs(exact).max(axis=0)).max())


@pytest.mark.parametrize(
    ("ability", "how", "coupling", "error"),
    [
        ("full", {"tolerance": 1e-4}, "hermite", 1e-3),
        ("full", {"step": 0.05}, "hermite", 1e-4),
        ("state", {"tolerance": 1e-3}, "derivative", 1e-3),
        ("held", {"tolerance": 1e-3}, "derivative", 1e-3),
        ("held", {"step": 0.05}, "derivative", 2e-2),
        ("fixed", {"step": 0.05}, "derivative", 2e-2),
    ],
)
def test_the_coupling_is_what_the_fmus_allow(parts, ability, how, coupling, error):
    result, found = run(PLAIN, parts, ability, **how)
    assert result.coupling == coupling
    assert result.choice.startswith(f"auto: {coupling}")
    assert found < error


def test_a_coupling_that_is_given_is_not_tried(parts):
    result, _ = run(PLAIN, parts, "full", step=0.05, coupling="derivative")
    assert (result.coupling, result.choice) == ("derivative", "")
    assert result.statistics.iterations == result.statistics.macro_steps


@pytest.mark.parametrize(("ability", "passes"), [("full", range(4, 16)), ("fixed", range(10, 30))])
def test_the_trial_counts_and_disturbs_nothing(parts, ability, passes):
    result, _ = run(PLAIN, parts, ability, step=0.05)
    same, _ = run(PLAIN, parts, ability, step=0.05, coupling=result.coupling)
    np.testing.assert_array_equal(result.values, same.values)
    assert result.statistics.iterations - same.statistics.iterations in passes
    assert result.statistics.fmi_calls > same.statistics.fmi_calls
    with SlavePool() as pool:
        pooled, _ = run(PLAIN, parts, ability, step=0.05, pool=pool)
        again, _ = run(PLAIN, parts, ability, step=0.05, pool=pool)
    np.testing.assert_array_equal(pooled.values, same.values)
    np.testing.assert_array_equal(again.values, same.values)


@pytest.mark.parametrize("ability", ["held", "state"])
@pytest.mark.parametrize("name", ["two_masses_plain", "drive", "algebraic_loop_0.95", "ladder"])
def test_errors_of_predicted_inputs_follow_the_tolerance(parts, ability, name):
    found = problem(name)
    errors = [run(found, parts, ability, tolerance=t)[1] for t in (1e-2, 1e-3)]
    assert max(errors[0] / 1e-2, errors[1] / 1e-3) < 3.0
    assert errors[1] < 0.3 * errors[0]


def test_extrapolation_that_is_unstable_is_not_taken(parts):
    drive = problem("drive")
    result, error = run(drive, parts, "fixed", step=5e-3)
    assert result.coupling == "gauss_seidel"
    assert "extrapolated inputs are worse than held ones" in result.choice
    assert error < 0.1


def test_a_sequence_whose_predictions_are_better_is_taken(parts):
    drive = problem("drive")
    result, error = run(drive, parts, "fixed", step=2e-3)
    assert result.choice.startswith("auto: derivative (jacobi), as ")
    assert "times nearer to their sources" in result.choice
    _, usual = run(drive, parts, "fixed", step=2e-3, coupling="derivative")
    assert error < 0.7 * usual


@pytest.mark.parametrize(
    ("ability", "how"),
    [("fixed", {"step": 0.05}), ("held", {"tolerance": 1e-3}), ("state", {"tolerance": 1e-3})],
)
def test_a_chain_without_feedback_has_the_means_of_its_inputs(parts, ability, how):
    chain = problem("chain")
    result, error = run(chain, parts, ability, **how)
    assert result.choice.startswith("auto: hermite, as ")
    assert "none feeds back to one before it" in result.choice
    passes = result.statistics.iterations
    assert passes <= result.statistics.macro_steps + result.statistics.rejected + 2
    _, usual = run(chain, parts, ability, step=chain.stop / passes, coupling="derivative")
    assert error < 0.3 * usual


@pytest.mark.parametrize("how", [{"step": 0.02}, {"tolerance": 1e-3}])
def test_iterations_are_taken_where_a_tried_step_shows_their_worth(parts, how):
    found = problem("predator_prey")
    result, error = run(found, parts, "state", **how)
    assert result.choice.startswith("auto: hermite, as not all FMUs take polynomials")
    assert "times its error in a tried step" in result.choice
    step = found.stop / result.statistics.iterations
    _, usual = run(found, parts, "state", step=step, coupling="derivative")
    assert error < 0.2 * usual
    other, _ = run(problem("two_masses_plain"), parts, "state", **how)
    assert other.coupling == "derivative"


def test_a_coupling_to_be_found_is_none():
    found = Experiment(stop_time=1.0, step=0.1)
    assert isinstance(found.given_coupling, Auto)
    assert not isinstance(found.given_coupling, Coupling)
    with pytest.raises(InvalidInput, match="'auto' stands for another one, which simulate and"):
        _ = found.chosen_coupling


@pytest.mark.parametrize("ability", ["held", "state", "full"])
def test_jumps_that_no_fmu_announces_are_passed_and_told(parts, ability):
    result = simulate(
        problem("relay").system(parts, ability), stop_time=10.0, tolerance=1e-4, max_steps=5000
    )
    assert result.status is Status.COMPLETED
    assert "a jump that no FMU announces" in result.message


@pytest.mark.parametrize("name", ["thermostat", "relay"])
def test_a_jump_does_not_pass_as_smooth(monkeypatch, parts, name):
    """With even steps, a jump looks like a smooth value of which 1/64 is missed."""
    found = problem(name)
    result, _ = run(found, parts, "full", tolerance=1e-2)
    assert result.coupling == "hermite"
    exact = found.exact(result.time)
    off = np.abs(result.values - exact)
    # The relay itself is off for part of a step.
    assert (off[:, :-1].max(axis=0) / np.abs(exact[:, :-1]).max(axis=0)).max() < 5e-3
    assert np.diff(result.time)[off[:-1, -1] > 0.0].sum() < 5e-3 * found.stop
    with monkeypatch.context() as patch:
        patch.setattr(library, "loaded", lambda: None)
        by_python, _ = run(found, parts, "full", tolerance=1e-2)
    np.testing.assert_array_equal(result.values, by_python.values)


@pytest.fixture(scope="module")
def pretenders(tmp_path_factory, parts):
    """A function that gives the folder of parts that declare everything and lack one thing."""
    made = {}

    def make(lack):
        if lack not in made:
            folder = tmp_path_factory.mktemp(f"lack{lack}")
            for path in parts.glob("*_full.fmu"):
                shutil.copy(path, folder)
            library = folder / "pretender.so"
            headers = [f"-I{fmpy.__path__[0]}/c-code", f"-I{benchmark.SOURCE.parent}"]
            how = ["-shared", "-fPIC", "-O2", *headers, f"-DLACK={lack}", "-lm", "-o", library]
            subprocess.run(["gcc", SOURCES / "pretender.c", *how], check=True)
            path = folder / "linear_full.fmu"
            with zipfile.ZipFile(path) as archive:
                description = archive.read("modelDescription.xml")
            with zipfile.ZipFile(path, "w") as archive:
                archive.write(library, f"binaries/{fmpy.platform}/parts.so")
                archive.writestr("modelDescription.xml", description)
            made[lack] = folder
        return made[lack]

    return make


@pytest.mark.parametrize(
    ("lack", "how", "told"),
    [
        (
            1,
            {"step": 0.02},
            "declares derivatives of its outputs, but refuses fmi2GetRealOutputDerivatives: ",
        ),
        (
            2,
            {"tolerance": 1e-3},
            "declares derivatives of its outputs, but all are zero while its outputs change",
        ),
        (
            3,
            {"tolerance": 1e-3},
            "declares inputs that follow polynomials, but refuses fmi2SetRealInputDerivatives: ",
        ),
        (
            4,
            {"tolerance": 1e-3},
            "declares states that can be saved and restored, but refuses fmi2GetFMUstate: ",
        ),
        (
            5,
            {"step": 0.02},
            "declares states that can be saved and restored, but a step from a restored one ",
        ),
    ],
)
def test_an_ability_that_is_declared_and_missing_is_told(pretenders, lack, how, told):
    result, error = run(PLAIN, pretenders(lack), "full", **how)
    # What FMUs put out without derivatives has them from its past, also in `hermite`.
    assert result.coupling == ("hermite" if lack in (1, 2) else "derivative")
    assert told in result.choice
    assert "\n" not in result.choice
    assert error < 3e-3


def test_steps_of_a_second_length_that_are_refused_ask_for_a_step(pretenders):
    with pytest.raises(InvalidInput, match="takes steps of one length only, and none is proposed"):
        run(PLAIN, pretenders(6), "full", tolerance=1e-3)
    result, _ = run(PLAIN, pretenders(6), "full", tolerance=1e-3, step=0.02)
    assert "declares steps of any length, but refuses the second one" in result.choice
    assert "steps of 0.02 s, as not all FMUs take others" in result.choice
    assert result.statistics.macro_steps == round(PLAIN.stop / 0.02)


def test_bars_of_a_run_without_a_coupling(pretenders, parts):
    for folder, ability, how, coupling in (
        (parts, "fixed", {"step": 0.02}, "derivative"),
        (parts, "held", {"tolerance": 1e-3}, "derivative"),
        (pretenders(1), "full", {"step": 0.02}, "hermite"),
    ):
        result, error = run(PLAIN, folder, ability, trust=True, **how)
        assert result.coupling == coupling
        assert error <= result.trust.error < 3.0 * error
        assert result.choice


@pytest.mark.parametrize("step", [0.4, 0.3, 5.0])
def test_the_trial_ends_before_the_run_does(step):
    """These FMUs refuse steps past the stop time, and take steps of any length before it."""
    system = System(
        (Component("p", FMUS / "ScalarPlant.fmu"), Component("c", FMUS / "ScalarController.fmu")),
        (Connection("p.x", "c.x"), Connection("c.u", "p.u")),
    )
    result = simulate(system, stop_time=0.5, step=step)
    assert result.completed, result.message
    assert "declares" not in result.choice


def test_a_system_without_connections_needs_no_abilities(parts):
    lonely = replace(PLAIN.system(parts, "fixed"), connections=())
    assert simulate(lonely, stop_time=1.0, step=0.1).completed
