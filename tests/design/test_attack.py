"""Attacks find what samples did not, and what they find holds through FMUs."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from congelation.cli import app
from congelation.cli.searches import VIOLATED
from congelation.design.attack import attack
from congelation.design.attack_problem import Admissible, problem_of
from congelation.design.finds import Attack
from congelation.design.found_scenario import write_finds
from congelation.errors import InvalidInput
from congelation.scenario.load import load_scenario
from congelation.sweep.engine import run
from congelation.theory.certificate import PerturbationSet
from tests.scenarios import ROOT, write

FIG2 = ROOT / "scenarios" / "fig2.toml"


@pytest.fixture(scope="module")
def quick() -> Attack:
    """A tenth of the effort."""
    return attack(load_scenario(FIG2), effort=0.1)


def value(found: Attack, variant: str, objective: str) -> float:
    (find,) = [f for f in found.finds if (f.variant, f.objective) == (variant, objective)]
    return find.value


@pytest.mark.slow
def test_controller_2_is_hurt_and_controller_1_is_not(quick: Attack) -> None:
    assert quick.missed == ()
    assert value(quick, "Controller 2", "peak") > 30.0
    assert value(quick, "Controller 2", "ise") > 450.0
    assert value(quick, "Controller 2", "late") > 5.0
    assert value(quick, "Controller 1", "peak") == pytest.approx(13.6, rel=0.05)
    assert value(quick, "Controller 1", "ise") == pytest.approx(34.4, rel=0.05)
    assert value(quick, "Controller 1", "late") < 1e-2


@pytest.mark.slow
def test_certificate_bounds_controller_1_from_above(quick: Attack) -> None:
    assert quick.violated == ()
    for find in quick.finds:
        assert find.certified == (find.variant == "Controller 1")
        if find.bound is not None:
            assert 0.0 < find.bound.energy <= find.bound.V0
            assert 0.0 < find.bound.decay <= find.bound.V0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*read from a table")
def test_finds_are_admissible_and_are_the_same_through_fmus(quick: Attack, tmp_path: Path) -> None:
    files = write_finds(quick, tmp_path)
    assert len(files) == len(quick.finds)
    for find, file in zip(quick.finds, files, strict=True):
        assert (np.abs(find.cells.theta - [-3.0, 2.0]) <= 1.0 + 1e-12).all()
        if find.variant != "Controller 2" or find.objective not in ("peak", "late"):
            continue
        scenario = load_scenario(file)
        alone = replace(
            scenario, variants=tuple(v for v in scenario.variants if v.name == find.variant)
        )
        (record,) = run(alone, out=tmp_path / file.stem).runs
        assert record.status == "COMPLETED"
        metric = {"peak": "peak_x", "late": "peak_late"}[find.objective]
        assert record.metrics[metric] == pytest.approx(find.value, rel=1e-4)


@pytest.mark.slow
def test_a_metric_without_gradient_is_attacked_without_derivatives() -> None:
    found = attack(
        load_scenario(FIG2), objectives=["settling_x"], variants=["Controller 1"], effort=0.05
    )
    assert found.missed == ()
    # Under Fig. 2's own theta(t) it settles in 1.8 s.
    assert value(found, "Controller 1", "settling_x") > 2.2


def test_equal_seeds_give_equal_finds() -> None:
    scenario = load_scenario(FIG2)
    one, two = (
        attack(scenario, objectives=["peak"], variants=["Controller 2"], effort=0.005)
        for _ in range(2)
    )
    assert one.finds[0].value == two.finds[0].value
    assert np.array_equal(one.finds[0].cells.edges, two.finds[0].cells.edges)


def narrow_attack() -> Attack:
    """Of a design for a ball of radius 0.1, whose theta fills a box of radius sqrt(2)."""
    scenario = load_scenario(FIG2)
    settings = {**scenario.variants[0].settings, "controller.delta": 0.1}
    variant = replace(scenario.variants[0], settings=settings)
    return attack(replace(scenario, variants=(variant,)), objectives=["peak"], effort=0.005)


def test_a_design_whose_theta_leaves_its_ball_is_not_called_certified() -> None:
    (find,) = narrow_attack().finds
    assert not find.certified
    assert find.bound is None
    assert not find.violated


def test_a_broken_certificate_is_exit_code_3(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = narrow_attack()
    broken = replace(found, finds=(replace(found.finds[0], certified=True, margin=1e-3),))
    monkeypatch.setattr("congelation.cli.searches.search", lambda *_, **__: broken)
    done = CliRunner().invoke(app, ["attack", str(FIG2), "--out", str(tmp_path)])
    assert done.exit_code == VIOLATED == 3


def test_without_a_varying_profile_the_ball_is_admissible(tmp_path: Path) -> None:
    file = write(
        tmp_path,
        FIG2.read_text(),
        *(
            (f'fmu = "{n}"', f'fmu = "{ROOT}/fmus/{n}.fmu"')
            for n in ("StrictFeedbackPlant", "StateFeedbackController")
        ),
        ("    {sine = {amplitude = 0.6, omega = 0.4}},\n", ""),
        ("    {square = {amplitude = 0.4, period = 1.3}},\n", ""),
        (
            "    {sine = {amplitude = 0.6, omega = 0.25, phase = 1.5707963267948966}},\n"
            "    {sine = {amplitude = 0.4, omega = 20.0}},\n",
            "",
        ),
    )
    problem = problem_of(load_scenario(file), "Controller 1")
    assert problem.admissible.ball is not None
    radii = np.linalg.norm(problem.admissible.extremes - [-3.0, 2.0], axis=1)
    assert radii == pytest.approx(np.sqrt(2.0))


def test_the_worst_theta_of_a_ball_respects_the_bound_on_one_element() -> None:
    ball = PerturbationSet(2.0, (False, True, True), first=1, delta_1=0.5)
    admissible = Admissible(np.zeros(3), np.zeros(3), ball)
    generator = np.random.default_rng(5)
    for gradient in generator.normal(size=(50, 3)):
        worst = admissible.worst(gradient)
        assert worst[0] == 0.0
        assert abs(worst[1]) <= 0.5
        assert np.linalg.norm(worst) == pytest.approx(2.0)
        for other in generator.normal(size=(50, 3)):
            assert gradient @ worst >= gradient @ admissible.worst(other) - 1e-12


def test_what_cannot_be_attacked_is_said_in_one_line() -> None:
    scenario = load_scenario(FIG2)
    with pytest.raises(InvalidInput, match="'peaks' is no objective; did you mean 'peak'"):
        attack(FIG2, objectives=["peaks"])
    with pytest.raises(InvalidInput, match="'Controller 3' is no variant"):
        attack(scenario, variants=["Controller 3"])
    with pytest.raises(InvalidInput, match=r"reference drives the loop.*--vary plant\.dtheta"):
        attack(ROOT / "scenarios" / "tracking.toml", variants=["steps"])


def test_command_writes_a_scenario(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "congelation", "attack", str(FIG2), "--out", str(tmp_path)]
    command += ["--objective", "peak", "--variant", "Controller 2", "--effort", "0.01"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert str(tmp_path / "controller_2_peak.toml") in done.stdout
    assert load_scenario(tmp_path / "controller_2_peak.toml").variants[1].name == "Controller 2"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*read from a table")
def test_the_strike_hits_controller_2_alone(tmp_path: Path) -> None:
    scenario = load_scenario(ROOT / "scenarios" / "strike.toml")
    one, two = (record.metrics for record in run(scenario, out=tmp_path).runs)
    assert one["peak_late"] < 1e-6
    assert two["peak_late"] == pytest.approx(1.0963, rel=1e-3)
    assert two["settling_x"] == pytest.approx(26.34, rel=1e-2)
