"""Scenarios composed in Python: the same checks as for a file, with the place in the call."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from congelation.cosim.system import Component, Connection, System
from congelation.errors import InvalidInput
from congelation.scenario.axes import RandomAxis, Replicates, Sweep
from congelation.scenario.constraint import Constraint
from congelation.scenario.load import load_scenario
from congelation.scenario.parts import Experiment, FigureSpec, MetricSpec, Variant
from congelation.scenario.scenario import Scenario
from congelation.sweep.engine import run
from tests.scenarios import FMUS, SHIPPED, write

SYSTEM = System(
    (
        Component("plant", FMUS / "ScalarPlant.fmu", {"x0": np.array([1.0])}),
        Component("controller", FMUS / "ScalarController.fmu", {"k_bar": 0.5, "epsilon": 0.3}),
    ),
    (Connection("plant.x", "controller.x"), Connection("controller.u", "plant.u")),
)


def compose(**changes: Any) -> Scenario:
    parts: dict[str, Any] = {
        "title": "A short loop",
        "system": SYSTEM,
        "experiment": Experiment(1.0, ("plant.x", "controller.theta_hat"), step=0.01),
        "metrics": (
            MetricSpec("peak_x", "peak", "plant.x"),
            MetricSpec("settling_x", "settling_time", "plant.x", {"below": 0.1}),
        ),
        "figures": (FigureSpec("loop", ("plant.x", "controller.u")),),
        "variants": (
            Variant("Controller 1", {"controller.damping": True}),
            Variant("Controller 2", {"controller.damping": False}),
        ),
    }
    return Scenario(**{**parts, **changes})


def test_it_is_the_scenario_of_the_file_that_says_the_same(tmp_path: Path) -> None:
    loaded = load_scenario(write(tmp_path))
    composed = compose(system=loaded.system)
    assert replace(composed, file=loaded.file, text=loaded.text) == loaded


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_a_scenario_composed_of_its_own_parts_is_the_same(file: Path) -> None:
    loaded = load_scenario(file)
    again = replace(loaded, title=loaded.title)
    if loaded.sweep is not None and loaded.sweep.axes:  # their places are in the call now
        assert again.sweep is not None
        places = [axis.place for axis in again.sweep.axes]
        assert places == [f"sweep.axes[{i}]" for i in range(len(places))]
        axes = tuple(replace(a, place="") for a in loaded.sweep.axes)
        loaded = replace(loaded, sweep=replace(loaded.sweep, axes=axes))
    assert again == loaded


def test_it_runs_without_a_file(tmp_path: Path) -> None:
    scenario = compose(variants=())
    assert scenario.file is None
    (record,) = run(scenario, out=tmp_path / "out").runs
    assert (record.variant, record.status) == ("run", "COMPLETED")


def test_settings_are_flat_and_plain() -> None:
    scenario = compose(
        variants=(Variant("both", {"plant.x0": np.array([2.0]), "experiment.step": 0.02}),),
        experiment=Experiment(stop_time=np.float64(1.0), step=0.01),
    )
    assert scenario.variants[0].settings == {"plant.x0[1]": 2.0, "experiment.step": 0.02}
    case = scenario.case(scenario.variants[0].settings)
    assert case.experiment.step == 0.02
    assert case.system.components[0].start["x0[1]"] == 2.0
    assert set(case.experiment.record) == {
        *("plant.x", "plant.theta[1]", "controller.u", "controller.theta_hat[1]")
    }


@pytest.mark.parametrize("before", ["limit", "limit[1]"])
@pytest.mark.parametrize("name", ["limit", "limit[1]"])
def test_a_setting_takes_the_place_of_a_start_value_however_both_name_it(
    before: str, name: str
) -> None:
    saturation = Component("saturation", FMUS / "Saturation.fmu", {before: 0.5})
    links = ("plant.x -> controller.x", "controller.u -> saturation.u", "saturation.y -> plant.u")
    scenario = compose(
        system=System((*SYSTEM.components, saturation), links),
        variants=(Variant("wider", {f"saturation.{name}": 2.0}),),
    )
    case = scenario.case(scenario.variants[0].settings)
    assert case.system.components[-1].start == {"limit[1]": 2.0}


def variant(settings: dict[str, Any]) -> tuple[Variant, ...]:
    return (Variant("one"), Variant("two", settings))


MISTAKES: dict[str, tuple[Callable[[], dict[str, Any]], str]] = {
    "title": (lambda: {"title": 1}, "title = 1 is not valid; give a text"),
    "step": (
        lambda: {"experiment": Experiment(1.0, step=-1.0)},
        "experiment.step = -1.0 is not valid; give a positive time in seconds",
    ),
    "start value": (
        lambda: {
            "system": replace(
                SYSTEM,
                components=(
                    SYSTEM.components[0],
                    Component("controller", FMUS / "ScalarController.fmu", {"k_baar": 1.0}),
                ),
            )
        },
        "Component('controller').start, start value 'k_baar': ",
    ),
    "connection": (
        lambda: {"system": replace(SYSTEM, connections=(Connection("plant.x", "controller.y"),))},
        "connection 'plant.x -> controller.y': ",
    ),
    "setting": (
        lambda: {"variants": variant({"controller.dampng": True})},
        "variants[1].settings['controller'], start value 'dampng': ",
    ),
    "experiment of a variant": (
        lambda: {"variants": variant({"experiment.step": 0})},
        "variants[1].settings['experiment.step'] = 0 is not valid; give a positive time",
    ),
    "two of one name": (
        lambda: {"variants": (Variant("one"), Variant("one"))},
        "variants[1].name = 'one' is given twice",
    ),
    "metric": (
        lambda: {"metrics": (MetricSpec("peak_x", "peek", "plant.x"),)},
        "MetricSpec('peak_x').metric: 'peek' is no metric; did you mean 'peak'?",
    ),
    "figure": (
        lambda: {"figures": (FigureSpec("loop", ("plant.y",)),)},
        "figures[0].panels: record 'plant.y': ",
    ),
    "axis": (
        lambda: {
            "sweep": Sweep(axes=(RandomAxis("plant.x0[2]", "uniform", (0.0, 1.0)),), samples=2)
        },
        "sweep.axes[0].plant, start value 'x0[2]': ",
    ),
    "list": (
        lambda: {"sweep": Sweep(lists=(({"plant.x0[1]": 1.0}, {"plant.x0[1]": "one"}),))},
        "sweep.lists[0].values[2].plant, start value 'x0[1]': 'one' given, a number needed",
    ),
    "list of other names": (
        lambda: {"sweep": Sweep(lists=(({"plant.x0[1]": 1.0}, {"controller.gamma": 1.0}),))},
        "sweep.lists[0] do not all set the same variables; give each of them plant.x0[1]",
    ),
    "constraint": (
        lambda: {
            "sweep": Sweep(
                lists=(({"plant.x0[1]": 1.0},),), constraints=(Constraint("plant.y > 1"),)
            )
        },
        "sweep.constraints: 'plant.y > 1': 'plant.y' is not swept",
    ),
    "replicates": (
        lambda: {"sweep": Sweep(replicates=Replicates(2, ("controller.gamma",)))},
        "sweep.reseed[1] = 'controller.gamma' is no integer parameter of a component",
    ),
}


@pytest.mark.parametrize(("changes", "message"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes_are_told_with_their_place_in_the_call(
    changes: Callable[[], dict[str, Any]], message: str
) -> None:
    with pytest.raises(InvalidInput) as told:
        compose(**changes())
    text = str(told.value)
    assert text.startswith("Scenario: ")
    assert message in text
    assert "\n" not in text


def test_applying_settings_checks_nothing_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan of a million points applies settings a million times."""
    scenario = compose()
    settings = {**scenario.variants[0].settings, "experiment.step": 0.02, "plant.x0[1]": 3.0}

    def again(*args: object, **kwargs: object) -> object:
        raise AssertionError("read a second time")

    for name in ("congelation.toml.Section.read", "congelation.toml.Section.value"):
        monkeypatch.setattr(name, again)
    monkeypatch.setattr("congelation.scenario.read_tables.describe", again)
    case = scenario.case(settings)
    assert (case.experiment.step, case.system.components[0].start["x0[1]"]) == (0.02, 3.0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"stop_time": 1.0, "step": 0.1, "coupling": "jakobi"}, "did you mean 'jacobi'"),
        ({"stop_time": "1", "step": 0.1}, "stop_time = '1' is not valid; give a number"),
        ({"stop_time": 1.0, "tolerance": True}, "tolerance = true is not valid; give a number"),
    ],
)
def test_an_experiment_that_cannot_be_is_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        Experiment(**values)


def test_keys_that_do_not_agree_are_told(tmp_path: Path) -> None:
    scenario = compose()
    with pytest.raises(InvalidInput) as told:
        scenario.case({"experiment.start_time": 2.0})
    assert str(told.value) == (
        "Scenario: experiment.stop_time = 1 is not valid; give a time after start_time = 2"
    )
