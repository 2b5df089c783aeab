"""The shipped scenarios show what they are for."""

from __future__ import annotations

import itertools
import json
import re
import shlex
import tomllib
from functools import partial
from pathlib import Path

import pytest

from congelation.cli import runs
from congelation.cli.shared import print_figures
from congelation.results.results import open_results
from congelation.scenario.load import load_scenario
from congelation.sweep.engine import run
from congelation.sweep.plan import plan_study
from congelation.verify.reference import LARGEST_DEVIATION
from tests.scenarios import FMUS, ROOT, SHIPPED
from tests.studies import command, done


@pytest.mark.slow
@pytest.mark.parametrize("name", ["scalar", "fig2", "fig3", "fig3_r11"])
def test_controller_1_settles_earlier_with_a_correct_solution(tmp_path: Path, name: str) -> None:
    scenario = load_scenario(ROOT / "scenarios" / f"{name}.toml")
    one, two = run(scenario, out=tmp_path, verify=True).runs
    assert [one.status, two.status] == ["COMPLETED", "COMPLETED"]
    settling = [found.metrics["settling_x"] or 0.0 for found in (one, two)]
    assert 0.0 < settling[0] < 0.7 * settling[1]
    if name != "scalar":
        assert (one.metrics["peak_u"] or 0.0) > (two.metrics["peak_u"] or 0.0)  # the price
    for found in (one, two):
        assert 0.0 < max(found.deviations.values()) < LARGEST_DEVIATION


def test_fig1_shows_fast_and_slow_variations_inside_the_box(tmp_path: Path) -> None:
    scenario = load_scenario(ROOT / "scenarios" / "fig1.toml")
    results = run(scenario, out=tmp_path)
    (found,) = results.runs
    trajectory = results.trajectory(found.run_id)
    assert found.status == "COMPLETED"
    theta_1, theta_2 = trajectory.select(("plant.theta[1]", "plant.theta[2]")).T
    assert (theta_1.min() >= -4.0, theta_1.max() <= -2.0) == (True, True)
    assert (theta_2.min() >= 1.0, theta_2.max() <= 3.0) == (True, True)
    assert theta_1.max() - theta_1.min() > 1.9
    assert theta_2.max() - theta_2.min() > 1.9


STUDIES = {"rate": 48, "design": 384, "step": 40, "monte_carlo": 2000}


@pytest.mark.parametrize(("name", "size"), STUDIES.items())
def test_the_studies_are_as_large_as_they_say(tmp_path: Path, name: str, size: int) -> None:
    scenario = load_scenario(ROOT / "scenarios" / f"study_{name}.toml")
    plan = plan_study(scenario, tmp_path, swept=True, write=False)
    assert plan.total == len(plan.missing) == size


PRINTED = {
    file.stem: [
        shlex.split(one, comments=True)[1:]
        for line in file.read_text(encoding="utf-8").splitlines()
        if line.startswith("#     congelation ")
        for one in line.removeprefix("#").split("&&")
    ]
    for file in SHIPPED
}
"""The commands in the heads of the shipped scenarios."""


def reduced(file: Path, stop_time: float) -> str:
    """A shipped scenario with another stop time, at most two variants, values and samples."""
    data = tomllib.loads(file.read_text(encoding="utf-8"))
    data["experiment"] |= {"stop_time": stop_time}
    for metric in data["metrics"].values():
        if "after" in metric:
            metric["after"] = 0.5 * stop_time
    data["variants"] = data.get("variants", [])[:2]
    sweep = data.get("sweep", {})
    sweep.pop("timeout", None)  # in seconds of a worker process, which these need not have
    if "samples" in sweep:
        sweep["samples"] = 2
    for axis in sweep.get("axes", ()):
        if "values" in axis:
            axis["values"] = axis["values"][:2]
        if "experiment.stop_time" in axis["set"]:
            axis["values"] = [[omega, stop_time] for omega, _ in axis["values"]]
    return "".join(f"{key} = {as_toml(value)}\n" for key, value in data.items())


def as_toml(value: object) -> str:
    """A value as TOML in one line."""
    if isinstance(value, dict):
        inner = (f"{json.dumps(key)} = {as_toml(each)}" for key, each in value.items())
        return "{" + ", ".join(inner) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(as_toml, value)) + "]"
    return json.dumps(value)


def test_the_head_of_each_study_prints_what_answers_it() -> None:
    """A study with lists of values is reported by them: its summary alone would pool them."""
    for file in SHIPPED:
        words = [printed[0] for printed in PRINTED[file.stem]]
        sweep = tomllib.loads(file.read_text(encoding="utf-8")).get("sweep")
        if sweep is not None:
            lists = any("values" in axis for axis in sweep["axes"])
            assert words == ["sweep", "report"][: 1 + lists], file.name


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, printed in PRINTED.items() if printed])
def test_the_printed_commands_answer_the_question(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Each is carried out on a shortened copy; the lines of a report pool nothing that matters."""
    monkeypatch.chdir(tmp_path)
    # A PDF beside each PNG would take a fifth of the time, and holds the same.
    monkeypatch.setattr(runs, "print_figures", partial(print_figures, formats=("png",)))
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "specs").symlink_to(ROOT / "specs")
    (tmp_path / "fmus").mkdir()
    for fmu in FMUS.glob("*.fmu"):
        (tmp_path / "fmus" / fmu.name).symlink_to(fmu)
    (tmp_path / "fmus" / "native").symlink_to(FMUS / "native")
    file = tmp_path / "scenarios" / f"{name}.toml"
    # A loop that has to settle takes longer; some saturated ones diverge after 0.06 s.
    stop_time = {"study_design": 3.0, "rivals_attack": 3.0}.get(name, 0.05)
    file.write_text(reduced(ROOT / "scenarios" / file.name, stop_time), encoding="utf-8")
    for arguments in PRINTED[name]:
        more = ["--effort", "0.01", "--objective", "peak"] if arguments[0] == "attack" else []
        done = command(*arguments, *more)
        assert done.returncode == 0, done.stderr
        if arguments[0] == "sweep":
            assert all(variant.name in done.stdout for variant in load_scenario(file).variants)
        if "--by" in arguments:
            header, *lines = done.stdout.splitlines()
            asked = [by for option, by in itertools.pairwise(arguments) if option == "--by"]
            first, second, completed, *_ = re.split(r"  +", header)
            assert (first.split(", "), second, completed) == (asked, "runs", "completed")
            pooled = 2 if name == "study_rate" else 1  # amplitudes
            total = len(open_results(tmp_path / "results" / name).runs)
            counts = [tuple(re.split(r"  +", line)[1:3]) for line in lines]
            assert counts == [(str(pooled), str(pooled))] * (total // pooled)
        if "--pareto" in arguments:
            assert "COMPLETED" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rate", "monte_carlo"])
def test_the_certificate_holds_for_controller_1_alone_whatever_theta_does(
    tmp_path: Path, name: str
) -> None:
    scenario = load_scenario(ROOT / "scenarios" / f"study_{name}.toml")
    plan = plan_study(scenario, tmp_path, swept=True, write=False)
    some = plan.missing[:: len(plan.missing) // 4 - 1]  # an odd step, so that both variants occur
    tasks = list(plan.tasks(some))
    assert {task.variant for task in tasks} == {"Controller 1", "Controller 2"}
    for task in tasks:
        outcome, _ = done(scenario, tmp_path, task.number)
        assert outcome.status == "COMPLETED"
        assert outcome.worst_margin == outcome.metrics["margin"]
        assert outcome.worst_margin is not None
        assert (outcome.worst_margin <= 1e-9) == (task.variant == "Controller 1")


@pytest.mark.slow
def test_held_inputs_are_wrong_where_hermite_is_right(tmp_path: Path) -> None:
    scenario = load_scenario(ROOT / "scenarios" / "study_step.toml")
    settings = {"controller.damping": True, "experiment.step": 1e-3}
    errors = {}
    for coupling in ("jacobi", "hermite"):
        chosen = {**settings, "experiment.coupling": coupling}
        errors[coupling] = done(scenario, tmp_path, 0, chosen)[0].metrics["error"] or 0.0
    assert errors["jacobi"] > 0.1
    assert 0.0 < errors["hermite"] < 1e-4
