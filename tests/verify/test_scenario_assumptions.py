"""The assumptions of the loops in a scenario, as `run` warns of them and `certify` refuses."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from congelation.errors import DesignWarning
from congelation.export.build import build
from congelation.scenario.load import load_scenario
from congelation.sweep.engine import sweep
from congelation.verify import scenario_assumptions
from congelation.verify.certify import Verdict, certify_design, designs_of
from congelation.verify.measure import judged
from congelation.verify.scenario_assumptions import (
    case_assumptions,
    scenario_warnings,
    sweep_warnings,
)
from tests.scenarios import FMUS, SCALAR, UNDRAWN, write

OBSERVER = f"""
title = "Output feedback"
connections = ["plant.y -> controller.y", "controller.u -> plant.u"]

[components.plant]
fmu = "{FMUS}/ObserverFormPlant.fmu"

[components.plant.profile]
"theta[1]" = [{{constant = 2.0}}]
"theta[2]" = [{{constant = -3.0}}, {{sine = {{amplitude = 0.6, omega = 0.4}}}}]
"theta[3]" = [{{constant = 2.0}}, {{sine = {{amplitude = 0.8, omega = 0.25}}}}]

[components.controller]
fmu = "{FMUS}/OutputFeedbackController.fmu"
start = {{delta = 1.0, delta_1 = 0.6}}

[experiment]
stop_time = 1.0
step = 0.01
record = ["plant.y"]
"""
AMPLITUDE = "plant.profile[1].square[1].amplitude"
SPEC = """
form = "scalar"
[plant]
name = "PLANT"
[controller]
name = "CONTROLLER"
start = {delta = 1}
"""
DRIVEN = (
    (
        "connections = [",
        'connections = ["driver.u -> plant.dtheta[1]", "plant.x -> driver.x", ',
    ),
    (
        "[experiment]",
        f'[components.driver]\nfmu = "{FMUS}/ScalarController.fmu"\n[experiment]',
    ),
    ("epsilon = 0.3", "epsilon = 0.3, delta = 0.4"),
)
"""Another controller, whose output is added to theta(t)."""


def warnings(folder: Path, text: str, *changes: tuple[str, str]) -> tuple[str, ...]:
    scenario = load_scenario(write(folder, text, *changes))
    remarks = case_assumptions(scenario.case(scenario.variants[0].settings))
    return tuple(str(remark) for remark in remarks)


def test_what_stands_gives_no_line(tmp_path):
    assert warnings(tmp_path, OBSERVER) == ()
    assert warnings(tmp_path, SCALAR) == ()


BROKEN = {
    "delta": (
        ("delta = 1.0", "delta = 0.5"),
        "controller.delta: 0.5 is less than 1, the radius of the box that theta(t) fills; "
        "give delta = 1, or narrow the profile",
    ),
    "delta_1": (
        ("delta_1 = 0.6", "delta_1 = 0.5"),
        "controller.delta_1: 0.5 is less than 0.6, the radius of the interval that "
        "a_(n-1)(t) = theta[2] fills; give delta_1 = 0.6, or narrow the profile",
    ),
    "sign": (
        ("delta = 1.0", "delta = 1.0, sign_b_m = -1.0"),
        "controller.sign_b_m: it is -1, while b_0 = theta[1] is positive, 2 (Assumption 3); "
        "give sign_b_m = 1",
    ),
    "sign of a constant dtheta": (
        (
            "[components.plant.profile]",
            "start = {dtheta = [-5.0, 0, 0]}\n[components.plant.profile]",
        ),
        "controller.sign_b_m: it is +1, while b_0 = theta[1] is negative, -3 (Assumption 3); "
        "give sign_b_m = -1",
    ),
    "b varies": (
        ("{constant = 2.0}]", "{constant = 2.0}, {sine = {amplitude = 0.5, omega = 1.0}}]"),
        'plant.profile."theta[1]": b_0 varies between 1.5 and 2.5, and output feedback is proved '
        "for constant b (Assumption 2); make it constant, such as [{constant = 2}]",
    ),
    "b jumps at random": (
        (
            "{constant = 2.0}]",
            "{constant = 2.0}, {telegraph = {amplitude = 0.5, rate = 1.0, seed = 1}}]",
        ),
        'plant.profile."theta[1]": b_0 varies between 1.5 and 2.5, and output feedback is proved '
        "for constant b (Assumption 2); make it constant, such as [{constant = 2}]",
    ),
    "set": (
        ("delta = 1.0", "delta = 1.0, projection_ball = true, theta_bound = 4.0, rho_bound = 0.1"),
        "controller.rho_center: the set of the adaptation law does not hold 1/b_0, (0.5), and the "
        "certificate is one for constants in the set; give rho_bound = 0.5 or more, or "
        "rho_center = [0.5]",
    ),
}


@pytest.mark.parametrize(("change", "line"), BROKEN.values(), ids=BROKEN)
def test_a_broken_assumption_is_one_line_and_refused(tmp_path, change, line):
    if change[0] == "{constant = 2.0}]":  # theta[1] alone
        change = (f'"theta[1]" = [{change[0]}', f'"theta[1]" = [{change[1]}')
    assert line in warnings(tmp_path, OBSERVER, change)
    (design,) = designs_of(tmp_path / "loop.toml")
    found = certify_design(design, samples=10)
    assert found.verdict is Verdict.ASSUMPTION_BROKEN
    assert line in found.reasons


AXES = """
[[sweep.axes]]
set = "controller.epsilon"
values = [0.2, 0.3]
[[sweep.axes]]
set = "plant.profile.theta[1].square.amplitude"
values = [0.2, 0.4, 0.9, 1.5]
"""
NARROW = ("epsilon = 0.3}", "epsilon = 0.3, delta = 0.4}")
BROKEN_AT = (
    "Controller 1, Controller 2: an assumption of the theorem is broken at 2 of 4 different points "
    "of the sweep (plant.profile[1].square[1].amplitude = 0.9 or 1.5), at worst: controller.delta: "
    "0.4 is less than 1.5, the radius of the box that theta(t) fills; give delta = 1.5, or narrow "
    "the profile"
)


def test_points_of_a_sweep_that_leave_the_ball_are_counted(tmp_path):
    """Of epsilon, which no assumption is about, different values are no different points."""
    scenario = load_scenario(write(tmp_path, SCALAR + AXES, NARROW))
    assert scenario_warnings(scenario) == ()
    assert sweep_warnings(scenario) == (f"{scenario.place}: {BROKEN_AT}",)
    allowed = load_scenario(write(tmp_path, SCALAR + AXES, NARROW, ("0.9, 1.5]", "0.1]")))
    assert sweep_warnings(allowed) == ()


def test_points_that_a_constraint_leaves_out_break_nothing(tmp_path):
    limit = '[sweep]\nconstraints = ["plant.profile.theta[1].square.amplitude <= 0.4"]\n'
    scenario = load_scenario(write(tmp_path, SCALAR + limit + AXES, NARROW))
    assert sweep_warnings(scenario) == ()


def test_of_a_million_points_the_extremes_are_looked_at(tmp_path, monkeypatch):
    drawn = """
[sweep]
samples = 1000000
[[sweep.axes]]
set = "plant.profile.theta[1].square.amplitude"
uniform = [0.1, 0.9]
"""
    looked_at = []

    def counting(case):
        looked_at.append(case)
        return case_assumptions(case)

    monkeypatch.setattr(scenario_assumptions, "case_assumptions", counting)
    scenario = load_scenario(write(tmp_path, SCALAR + drawn, NARROW))
    (line,) = sweep_warnings(scenario)
    assert "broken at points of the sweep (plant.profile[1].square[1].amplitude = 0.9): " in line
    assert len(looked_at) == 6  # of each variant itself, the least and the largest amplitude


def test_a_run_that_leaves_the_ball_has_no_margin_that_says_that_the_certificate_holds(tmp_path):
    """A margin that is a violation is kept."""
    metric = ("[metrics]", '[metrics]\nmargin = {metric = "lyapunov"}')
    axis = AXES.replace("0.2, 0.4, 0.9, 1.5", "0.4, 1.5").replace("0.2, 0.3", "0.3")
    scenario = load_scenario(write(tmp_path, SCALAR + axis, NARROW, metric, UNDRAWN))
    with pytest.warns(DesignWarning, match=re.escape("broken at 1 of 2 different points")):
        results = sweep(scenario, out=tmp_path / "out")
    within, outside = (
        {r.variant: r for r in results.runs if r.settings[AMPLITUDE] == a} for a in (0.4, 1.5)
    )
    for variant in ("Controller 1", "Controller 2"):
        assert within[variant].metrics["margin"] <= 1e-9
        assert within[variant].remark == ""
        assert outside[variant].metrics["margin"] is None
        assert outside[variant].worst_margin is None
        assert "No margin, as an assumption" in outside[variant].remark
        assert "controller.delta: 0.4 is less than 1.5" in outside[variant].remark
    case = scenario.case({AMPLITUDE: 1.5})
    assert judged(scenario.metrics, case, {"peak_x": 1.0, "settling_x": 1.0, "margin": 0.1}) == (
        {"peak_x": 1.0, "settling_x": 1.0, "margin": 0.1},
        (),
    )


def test_theta_that_another_component_drives_cannot_be_known(tmp_path):
    (line,) = warnings(tmp_path, SCALAR, *DRIVEN)
    assert line == (
        'plant.profile."theta[1]": that theta(t) keeps to the assumptions cannot be known for '
        "sure: theta[1] has an input, dtheta, that another component drives; keep it within delta "
        "of the centre, and b constant and Hurwitz where there is one"
    )
    for design in designs_of(tmp_path / "loop.toml"):
        found = certify_design(design, samples=50)
        assert found.verdict is Verdict.HOLDS
        assert found.warnings == (line,)


def test_theta_without_a_profile_is_named(tmp_path):
    """Neither the spec of the FMU nor the scenario gives it one."""
    text = SPEC.replace("PLANT", "BarePlant").replace("CONTROLLER", "BareController")
    (tmp_path / "bare.toml").write_text(text)
    with pytest.warns(DesignWarning, match="no profile"):
        build(tmp_path / "bare.toml", out=tmp_path)
    changes = (
        (f"{FMUS}/ScalarPlant", f"{tmp_path}/BarePlant"),
        (
            f"{FMUS}/ScalarController",
            f"{tmp_path}/BareController",
        ),
    )
    assert warnings(tmp_path, SCALAR, *changes) == ()
    profile = '"theta[1]" = [{constant = -3.0}, {square = {amplitude = 0.4, period = 0.3}}]'
    (line,) = warnings(tmp_path, SCALAR, *changes, (profile, ""))
    assert line.startswith('plant.profile."theta[1]": it has no profile, and is 0 throughout')


def test_build_warns_of_what_it_builds(tmp_path):
    """One warning for each remark, and the FMUs all the same."""
    text = SPEC.replace("PLANT", "WarnedPlant").replace("CONTROLLER", "WarnedController")
    profile = '[plant.profile]\n"theta[1]" = [{sine = {amplitude = 3, omega = 1}}]\n[controller]'
    (tmp_path / "warned.toml").write_text(text.replace("[controller]", profile))
    line = (
        "spec 'warned': controller.start.delta: 1 is less than 3, the radius of the box that "
        "theta(t) fills; give delta = 3, or narrow the profile"
    )
    with pytest.warns(DesignWarning, match=re.escape(line)):
        build(tmp_path / "warned.toml", out=tmp_path)
    assert (tmp_path / "WarnedPlant.fmu").is_file()


def test_what_is_no_loop_of_ours_has_no_remarks(tmp_path):
    changes = (', "controller.u -> plant.u"', "")
    scenario = load_scenario(write(tmp_path, SCALAR, changes))
    assert case_assumptions(scenario.case({})) == ()
