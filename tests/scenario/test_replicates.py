"""Replicates: points repeated with fresh seeds, the same ones everywhere."""

from __future__ import annotations

from pathlib import Path

import pytest

from congelation.errors import InvalidInput
from congelation.scenario.axes import Replicates
from congelation.scenario.load import load_scenario
from congelation.sweep.sweep_plan import Plan, plan_sweep
from tests.scenarios import SCALAR, write

SEED = "plant.profile[1].telegraph[1].seed"

REPLICATED = f"""
[sweep]
seed = 7
replicates = 3
reseed = ["{SEED}"]

[[sweep.axes]]
set = "controller.epsilon"
values = [0.5, 1.0]
"""


def plan(folder: Path, *changes: tuple[str, str]) -> Plan:
    file = write(folder, SCALAR + REPLICATED, *changes)
    return plan_sweep(load_scenario(file), folder / "out", resume=True)


def seeds(of: Plan, **settings: object) -> list[object]:
    """The seeds of the runs that have some settings, by replicate."""
    wanted = {name.replace("__", "."): value for name, value in settings.items()}
    found = {
        task.replicate: task.settings[SEED]
        for task in of.missing
        if all(task.settings[name] == value for name, value in wanted.items())
    }
    assert list(found) == list(range(1, len(found) + 1))
    return list(found.values())


def test_every_point_and_variant_has_the_same_fresh_seeds(tmp_path: Path) -> None:
    planned = plan(tmp_path)
    assert len(planned.run_ids) == 2 * 2 * 3
    first = seeds(planned, controller__epsilon=0.5, controller__damping=True)
    assert len(set(first)) == 3
    for epsilon in (0.5, 1.0):
        for damping in (False, True):
            chosen = {"controller__epsilon": epsilon, "controller__damping": damping}
            assert seeds(planned, **chosen) == first


def test_more_replicates_leave_those_there_are(tmp_path: Path) -> None:
    few, many = plan(tmp_path), plan(tmp_path, ("replicates = 3", "replicates = 40"))
    assert set(few.run_ids) < set(many.run_ids)
    assert len(many.run_ids) == 2 * 2 * 40
    assert seeds(many)[:3] == seeds(few)


def test_another_seed_of_the_sweep_gives_others(tmp_path: Path) -> None:
    other = plan(tmp_path, ("seed = 7", "seed = 8"))
    assert not {*seeds(other)} & {*seeds(plan(tmp_path))}


def test_seeds_are_distinct_also_between_settings_and_fit_an_fmu() -> None:
    drawn = list(Replicates(100_000, ("a", "b")).seeds(1))
    numbers = [value for settings in drawn for value in settings.values()]
    assert len(set(numbers)) == 200_000  # without a redraw about nine would come twice
    assert 0 <= min(numbers) < 2**20
    assert 2**31 - 2**20 < max(numbers) < 2**31


def test_seeds_do_not_change_between_versions() -> None:
    """Rows of old sweeps stay those of the same scenario: SeedSequence promises as much."""
    found = list(Replicates(2, ("a", "b")).seeds(2018))
    assert found == [{"a": 464059665, "b": 1875879433}, {"a": 396055239, "b": 536551441}]


def test_replicates_need_no_axis(tmp_path: Path) -> None:
    axis = REPLICATED[REPLICATED.index("[[sweep.axes]]") :]
    assert len(plan(tmp_path, (axis, "")).run_ids) == 2 * 3


RESEED = f'reseed = ["{SEED}"]'
MISTAKES = {
    "none": (
        "replicates = 3",
        "replicates = 0",
        "sweep.replicates = 0 is not valid; give a w",
    ),
    "half": ("replicates = 3", "replicates = 2.5", "sweep.replicates = 2.5 is not valid; give a w"),
    "negative seed": ("seed = 7", "seed = -7", "sweep.seed = -7 is not valid; give a whole number"),
    "nothing to reseed": (RESEED, "", "sweep.reseed is missing; name the settings that replicates"),
    "no replicates": ("replicates = 3", "", "sweep.reseed has no meaning without replicates"),
    "unknown variable": ("].seed", "].sed", "did you mean 'profile[1].telegraph[1].seed'?"),
    "unknown component": ("plant.profile[1].t", "plan.profile[1].t", "did you mean 'plant'?"),
    "a real number": (
        RESEED,
        'reseed = ["controller.gamma"]',
        "sweep.reseed[1] = 'controller.gamma' is no integer parameter of a component",
    ),
    "a truth value": (
        RESEED,
        f'reseed = ["{SEED}", "controller.damping"]',
        "sweep.reseed[2] = 'controller.damping' is no integer parameter of a component",
    ),
    "a string": (
        RESEED,
        'reseed = ["plant.profile[1].table.file"]',
        "sweep.reseed[1].plant, start value 'profile[1].table.file': 1 given, a string needed",
    ),
    "the experiment": (
        RESEED,
        'reseed = ["experiment.output_every"]',
        "sweep.reseed[1] = 'experiment.output_every' is no integer parameter of a component",
    ),
    "twice": (
        RESEED,
        f'reseed = ["{SEED}", "{SEED}"]',
        f"sweep.reseed[2] = '{SEED}' is set by sweep.reseed[1] already",
    ),
    "an axis": (
        'set = "controller.epsilon"\nvalues = [0.5, 1.0]',
        f'set = "{SEED}"\nvalues = [1, 2]',
        f"sweep.reseed[1] = '{SEED}' is set by sweep.axes[1] already",
    ),
}


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes_are_told_with_their_place(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    with pytest.raises(InvalidInput) as told:
        plan(tmp_path, (old, new))
    assert str(told.value).startswith(f"{tmp_path / 'loop.toml'}: ")
    assert message in str(told.value)
