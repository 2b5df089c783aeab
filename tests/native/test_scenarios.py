"""`native = true` in a scenario."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from congelation.errors import InvalidInput
from congelation.scenario.load import load_scenario
from tests.scenarios import FMUS, SCALAR, write
from tests.studies import done

BY_NAME = tuple(
    (f'"{FMUS}/{name}.fmu"', f'"{name}"') for name in ("ScalarPlant", "ScalarController")
)
NATIVE = tuple(
    (f'"{name}"', f'"{name}"\nnative = true') for name in ("ScalarPlant", "ScalarController")
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder in which names of FMUs mean those of the checkout."""
    (tmp_path / "fmus").symlink_to(FMUS)
    return tmp_path


def test_the_twin_gives_the_same_trajectory(folder: Path) -> None:
    runs = []
    for number, changes in enumerate((BY_NAME, (*BY_NAME, *NATIVE))):
        scenario = load_scenario(write(folder, SCALAR, *changes))
        paths = {Path(c.fmu).parent.name for c in scenario.system.components}
        assert paths == {"native" if number else "fmus"}
        outcome, trajectory = done(scenario, folder / f"out{number}")
        assert outcome.status == "COMPLETED", outcome.message
        runs.append(trajectory.values)
    assert np.array_equal(*runs)


def test_what_is_not_built_is_named(folder: Path) -> None:
    wrong = ('"ScalarPlant"\nnative', '"ScalarPlan"\nnative')
    with pytest.raises(InvalidInput) as error:
        load_scenario(write(folder, SCALAR, *BY_NAME, *NATIVE, wrong))
    assert (
        "components.plant.fmu = 'ScalarPlan' is no FMU in fmus/native/; did you mean 'ScalarPlant'?"
        in str(error.value)
    )
    assert str(error.value).endswith("build it with: congelation build SPEC.toml --native")


def test_a_path_states_the_twin_itself(folder: Path) -> None:
    change = (f'"{FMUS}/ScalarPlant.fmu"', f'"{FMUS}/ScalarPlant.fmu"\nnative = true')
    with pytest.raises(InvalidInput) as error:
        load_scenario(write(folder, SCALAR, change))
    assert "components.plant.native = true goes with a name" in str(error.value)
    assert 'fmu = "ScalarPlant"' in str(error.value)
