"""Inputs and parameters of FMUs attacked by runs alone."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from congelation.cosim import simulate
from congelation.design.attack_fmus import attack_fmus
from congelation.design.attack_problem import Varied
from congelation.design.found_scenario import driven, write_finds
from congelation.design.shooting import Cells
from congelation.errors import InvalidInput
from congelation.scenario.load import load_scenario
from congelation.scenario.scenario import Scenario
from congelation.sweep.engine import run
from tests.scenarios import FMUS, SCALAR, write

SOURCE = FMUS / "ScalarPlant.fmu"


@pytest.fixture
def scenario(tmp_path: Path) -> Scenario:
    return load_scenario(write(tmp_path, SCALAR, ("step = 0.01", "step = 0.02")))


@pytest.mark.filterwarnings("ignore:.*another component drives")
def test_input_and_parameter_that_do_most_harm_are_played_again(
    scenario: Scenario, tmp_path: Path
) -> None:
    """x' = -theta x + u: the least theta and the least gain make the peak largest."""
    vary = {"plant.dtheta[1]": (-1.0, 1.0), "controller.k_bar": (0.25, 0.5)}
    found = attack_fmus(
        scenario,
        vary,
        objectives=["peak_x"],
        variants=["Controller 2"],
        effort=0.1,
        source=SOURCE,
    )
    assert found.missed == ()
    (find,) = found.finds
    (own,) = (
        record.metrics["peak_x"]
        for record in run(scenario, out=tmp_path / "own").runs
        if record.variant == "Controller 2"
    )
    assert find.value > own
    (file,) = write_finds(found, tmp_path / "finds")
    played = load_scenario(file)
    assert any(c.name.startswith("source_plant") for c in played.system.components)
    records = run(played, out=tmp_path / "played").runs
    (again,) = (r.metrics["peak_x"] for r in records if r.variant == "Controller 2")
    assert again == pytest.approx(find.value, rel=1e-3)


@pytest.mark.parametrize("folder", ["", "native"])
def test_a_table_drives_an_input_from_fmus_of_both_kinds(
    scenario: Scenario, tmp_path: Path, folder: str
) -> None:
    """theta + dtheta goes from 0 to 2 where the table jumps: x' = -(theta + dtheta) x + u."""
    varied = Varied("plant", "dtheta[1]", -1.0, 2.0, True)
    cells = Cells(np.array([0.0, 0.5, 1.0]), np.array([[-1.0], [2.0]]))
    source = FMUS / folder / "ScalarPlant.fmu"
    system, _ = driven(scenario.system, cells, [varied], source, tmp_path, "find")
    result = simulate(
        system, stop_time=1.0, tolerance=1e-6, record=["plant.dtheta[1]", "plant.theta[1]"]
    )
    assert result.completed
    before, after = (result.values[result.time < 0.5], result.values[result.time > 0.5])
    assert set(before[:, 0]) == {-1.0}
    assert set(after[:, 0]) == {2.0}


def test_runs_that_fail_are_counted_and_said(scenario: Scenario) -> None:
    """epsilon <= 0 is refused by the FMU: half of the bounds say nothing."""
    found = attack_fmus(
        scenario,
        {"controller.epsilon": (-1.0, 1.0)},
        objectives=["peak_x"],
        variants=["Controller 1"],
        effort=0.05,
        source=SOURCE,
    )
    (note,) = found.notes
    assert re.match(r"Controller 1: peak_x: \d+ of \d+ runs did not reach the stop time", note)
    assert "epsilon" in note


@pytest.mark.parametrize(
    ("name", "bounds", "message"),
    [
        ("plant.dthetas[1]", (0.0, 1.0), "is no Real input or parameter"),
        ("plants.x", (0.0, 1.0), "no component 'plants'; did you mean 'plant'"),
        ("plant.u", (0.0, 1.0), "is driven by 'controller.u -> plant.u'"),
        ("plant.dtheta[1]", (1.0, 1.0), "give a lower and a higher number"),
    ],
)
def test_what_cannot_be_varied_is_said(
    scenario: Scenario, name: str, bounds: tuple[float, float], message: str
) -> None:
    with pytest.raises(InvalidInput, match=message):
        attack_fmus(scenario, {name: bounds}, objectives=["peak_x"], source=SOURCE)


def test_a_variant_that_there_is_not_is_named(scenario: Scenario) -> None:
    vary, variants = {"plant.dtheta[1]": (0.0, 1.0)}, ["Controller 3"]
    with pytest.raises(InvalidInput, match="'Controller 3' is no variant; did you mean"):
        attack_fmus(scenario, vary, objectives=["peak_x"], variants=variants, source=SOURCE)
