"""Scenario files: what they say is what runs, and every mistake is told with its place."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from congelation.cosim.master import simulate
from congelation.cosim.system import Component, System
from congelation.errors import InvalidInput
from congelation.scenario.load import load_scenario
from congelation.scenario.scenario import Case, Scenario, Variant
from congelation.signals import Profile, Sine, Square, profile
from congelation.sweep.engine import sweep
from tests.scenarios import FMUS, ROOT, SCALAR, SHIPPED, write


def component(case: Case | Scenario, name: str) -> Component:
    return next(c for c in case.system.components if c.name == name)


def theta(case: Case, j: int) -> Profile:
    start, prefix = component(case, "plant").start, f"profile[{j}]."
    return Profile.from_flat(
        {name.removeprefix(prefix): v for name, v in start.items() if name.startswith(prefix)}
    )


THETA_1 = profile(-3.0, Sine(0.6, 0.4), Square(0.4, 1.3))
THETA_2 = profile(2.0, Sine(0.6, 0.25, math.pi / 2), Sine(0.4, 20.0))


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_shipped_scenarios_load(file: Path) -> None:
    assert load_scenario(file).variants


@pytest.mark.parametrize("name", ["scalar", "fig2", "fig3", "fig3_r11"])
def test_the_paper_compares_two_controllers(name: str) -> None:
    scenario = load_scenario(ROOT / "scenarios" / f"{name}.toml")
    assert [variant.name for variant in scenario.variants] == ["Controller 1", "Controller 2"]
    assert scenario.figures[0].name == name


def test_fig2_states_the_values_of_section_5() -> None:
    scenario = load_scenario(ROOT / "scenarios" / "fig2.toml")
    case = scenario.case({})
    start = component(case, "controller").start
    assert [start["c[1]"], start["c[2]"], start["epsilon"]] == [0.5, 0.5, 0.3]
    assert start["delta"] == math.sqrt(2.0)
    assert [start[f"Gamma[{i}]"] for i in ("1,1", "1,2", "2,1", "2,2")] == [1.0, 0.0, 0.0, 1.0]
    plant = component(case, "plant").start
    assert [plant["x0[1]"], plant["x0[2]"]] == [2.0, -1.0]
    assert [theta(case, 1), theta(case, 2)] == [THETA_1, THETA_2]
    assert [v.settings["controller.damping"] for v in scenario.variants] == [True, False]


@pytest.mark.parametrize(
    ("name", "r", "epsilon"), [("fig3", 5.0, math.sqrt(0.1)), ("fig3_r11", 11.0, 0.1)]
)
def test_fig3_states_the_values_of_section_5(name: str, r: float, epsilon: float) -> None:
    case = load_scenario(ROOT / "scenarios" / f"{name}.toml").case({})
    start = component(case, "controller").start
    assert [start["c[1]"], start["c[2]"], start["d[1]"], start["d[2]"]] == [0.8, 0.8, 0.2, 0.2]
    assert [start["r"], start["epsilon"], start["gamma"]] == [r, epsilon, 1.0]
    assert [start["delta"], start["delta_1"]] == [math.sqrt(2.0), 1.0]
    assert [theta(case, 1), theta(case, 2), theta(case, 3)] == [profile(1.0), THETA_1, THETA_2]


def test_variants_change_what_they_name_and_nothing_else(tmp_path: Path) -> None:
    scenario = load_scenario(
        write(
            tmp_path,
            SCALAR,
            (
                '{"controller.damping" = false}',
                '{"controller.damping" = false, "plant.x0" = [2.0], experiment.step = 0.02, '
                '"plant.profile.theta[1]" = [{constant = 1.0}], controller.k_bar = 7}',
            ),
        )
    )
    first, second = (scenario.case(variant.settings) for variant in scenario.variants)
    assert component(first, "plant").start["x0[1]"] == 1.0
    assert component(second, "plant").start["x0[1]"] == 2.0
    assert (first.experiment.step, second.experiment.step) == (0.01, 0.02)
    assert theta(first, 1) == profile(-3.0, Square(0.4, 0.3))
    assert theta(second, 1) == profile(1.0)
    assert component(second, "controller").start["k_bar"] == 7.0
    assert component(second, "controller").start["epsilon"] == 0.3
    assert second.experiment.stop_time == 1.0


OMEGA = "plant.profile[1].sine[1].omega"

SPELLINGS = {
    "plant.profile[1].sine[1].omega": OMEGA,
    "plant.profile.theta[1].sine[1].omega": OMEGA,
    "plant.profile.theta[1].sine.omega": OMEGA,
    "plant.profile.theta[1].sine[2].omega": "plant.profile[1].sine[2].omega",
    "plant.profile.theta[1].square.phase": "plant.profile[1].square[1].phase",
    "plant.profile.theta[1].constant": "plant.profile[1].mean",
    "plant.profile.theta[1].mean": "plant.profile[1].mean",
}


@pytest.mark.parametrize(("spelled", "name"), SPELLINGS.items())
def test_a_number_of_a_profile_is_spelled_alike_everywhere(
    tmp_path: Path, spelled: str, name: str
) -> None:
    sweep = f"""
        [sweep]
        constraints = ["{spelled} < 6"]
        [[sweep.axes]]
        set = "{spelled}"
        values = [4.0, 5.0, 6.0]
        """
    changed = f'{{"controller.damping" = true, "{spelled}" = 4.0}}'
    old = '{"controller.damping" = true}'
    set_by_variant = load_scenario(write(tmp_path, SCALAR, (old, changed))).variants[0]
    assert set_by_variant.settings == {"controller.damping": True, name: 4.0}
    scenario = load_scenario(write(tmp_path, SCALAR + sweep))
    assert scenario.sweep is not None
    assert list(scenario.sweep.points()) == [{name: 4.0}, {name: 5.0}]
    random = sweep.replace("values = [4.0, 5.0, 6.0]", "uniform = [4.0, 5.0]")
    random = random.replace("[sweep]", "[sweep]\nsamples = 1")
    drawn = load_scenario(write(tmp_path, SCALAR + random)).sweep
    assert drawn is not None
    assert [list(point) for point in drawn.points()] == [[name]]
    settings = {spelled: 4.0}
    composed = replace(scenario, variants=(Variant("one", settings),), sweep=None)
    assert composed.variants[0].settings == {name: 4.0}


MISSPELT = {
    "unknown component": (
        "plant.profile.theta[2].sine.omega",
        "4.0",
        "plant.profile.theta[2].sine.omega is no parameter with a profile; did you mean",
    ),
    "unknown term": (
        "plant.profile.theta[1].sinus.omega",
        "4.0",
        "plant.profile.theta[1].sinus.omega is no part of this profile; did you mean 'sine.omega'?",
    ),
    "unknown number": (
        "plant.profile.theta[1].sine.omga",
        "4.0",
        "plant.profile.theta[1].sine.omga is no part of this profile; did you mean 'sine.omega'?",
    ),
    "more terms than fit": (
        "plant.profile.theta[1].sine[3].omega",
        "4.0",
        "plant.profile.theta[1].sine[3].omega is no part of this profile; did you mean 'sine[",
    ),
    "no number": (
        "plant.profile.theta[1].sine.omega",
        '"fast"',
        "plant.profile.theta[1].sine.omega, start value 'profile[1].sine[1].omega': 'fast' given",
    ),
    "another unit": (
        "plant.profile.theta[1].sine.omega",
        '{value = 4.0, unit = "K"}',
        "unit = 'K' is not the unit of 'profile[1].sine[1].omega'",
    ),
    "one of two": (
        "plant.profile.theta[1].square.period",
        "4.0",
        "plant.profile.theta[1].square.period is one of 2; give square[1].period or square[2]",
    ),
    "a table for a term": (
        "plant.profile.theta[1].sine",
        "{omega = 4.0}",
        "plant.profile.theta[1].sine is no part of this profile; did you mean",
    ),
}


@pytest.mark.parametrize(("spelled", "value", "message"), MISSPELT.values(), ids=MISSPELT)
def test_a_number_of_no_profile_is_refused_alike_everywhere(
    tmp_path: Path, spelled: str, value: str, message: str
) -> None:
    two = (
        "{square = {amplitude = 0.4, period = 0.3}}",
        "{square = {amplitude = 0.4, period = 0.3}}, {square = {amplitude = 0.1, period = 1.0}}",
    )
    changed = f'{{"controller.damping" = true, "{spelled}" = {value}}}'
    axis = f'\n[sweep]\n[[sweep.axes]]\nset = "{spelled}"\nvalues = [{value}]\n'
    told = []
    for text, changes in (
        (SCALAR, [two, ('{"controller.damping" = true}', changed)]),
        (SCALAR + axis, [two]),
    ):
        with pytest.raises(InvalidInput) as refused:
            load_scenario(write(tmp_path, text, *changes))
        told.append(str(refused.value))
    places = (": variants[1].set.", ": sweep.axes[1].values[1].")
    assert all(place in line and message in line for place, line in zip(places, told, strict=True))
    assert told[0].partition(places[0])[2] == told[1].partition(places[1])[2]


@pytest.mark.parametrize(
    "spelled",
    ["plant.profile[1].square[1].period", "plant.profile.theta[1].square.period"],
)
@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("[[variants]]\nname = 'x'\nset = {'NAME' = -3.0}", "variants[3].set.plant"),
        ("[sweep]\n[[sweep.axes]]\nset = 'NAME'\nvalues = [0.3, -3.0]", "axes[1].values[2].plant"),
        ("[sweep]\nsamples = 2\n[[sweep.axes]]\nset = 'NAME'\nuniform = [-3, 1]", "axes[1].plant"),
    ],
)
def test_a_number_that_makes_no_profile_is_refused(
    tmp_path: Path, spelled: str, text: str, place: str
) -> None:
    with pytest.raises(InvalidInput) as told:
        load_scenario(write(tmp_path, SCALAR + text.replace("NAME", spelled)))
    assert f"{place}: profile[1].square[1].period = -" in str(told.value)
    assert str(told.value).endswith("must be a finite number above 0")


def test_a_whole_profile_and_a_number_of_it_exclude_each_other(tmp_path: Path) -> None:
    both = '{"plant.profile.theta[1]" = 1.0, "plant.profile.theta[1].sine.omega" = 4.0}'
    with pytest.raises(InvalidInput, match=r"omega gives 'profile\[1\].sine\[1\].omega' a second"):
        load_scenario(write(tmp_path, SCALAR, ('{"controller.damping" = true}', both)))
    whole = '\n[sweep]\n[[sweep.axes]]\nset = "plant.profile.theta[1]"\nvalues = [-3.0, [{sine = {'
    sweep = load_scenario(write(tmp_path, SCALAR + whole + "amplitude = 1, omega = 2}}]]\n")).sweep
    assert sweep is not None
    sines = [p["plant.profile[1].sine[1].amplitude"] for p in sweep.points()]
    assert sines == [0.0, 1.0]
    assert [p["plant.profile[1].mean"] for p in sweep.points()] == [-3.0, 0.0]


def test_times_and_start_values_may_state_their_units(tmp_path: Path) -> None:
    scenario = load_scenario(
        write(
            tmp_path,
            SCALAR,
            ("stop_time = 1.0", 'stop_time = {value = 0.5, unit = "min"}'),
            ("step = 0.01", 'step = {value = 20, unit = "ms"}'),
            ("k_bar = 0.5", 'k_bar = {value = 0.5, unit = "1/s"}'),
        )
    )
    case = scenario.case({})
    assert (case.experiment.stop_time, case.experiment.step) == (30.0, 0.02)
    assert component(case, "controller").start["k_bar"] == 0.5


def test_what_is_measured_and_drawn_is_recorded(tmp_path: Path) -> None:
    case = load_scenario(write(tmp_path)).case({})
    assert case.experiment.record == ("plant.x", "controller.theta_hat[1]", "controller.u")


def test_by_default_every_output_is_recorded(tmp_path: Path) -> None:
    file = write(tmp_path, SCALAR, ('record = ["plant.x", "controller.theta_hat"]\n', ""))
    record = load_scenario(file).case({}).experiment.record
    assert set(record) == {"plant.x", "plant.theta[1]", "controller.u", "controller.theta_hat[1]"}


def test_a_profile_table_is_found_next_to_the_scenario(tmp_path: Path) -> None:
    (tmp_path / "theta.csv").write_text("time,value\n0,-3\n1,-2\n")
    spec = '[{table = {file = "theta.csv", linear = true}}]'
    old = "[{constant = -3.0}, {square = {amplitude = 0.4, period = 0.3}}]"
    case = load_scenario(write(tmp_path, SCALAR, (old, spec))).case({})
    assert theta(case, 1).value(0.5) == -2.5


def test_fmus_are_found_by_name_in_a_folder_above(tmp_path: Path) -> None:
    (tmp_path / "fmus").symlink_to(FMUS)
    (tmp_path / "deep" / "er").mkdir(parents=True)
    file = write(
        tmp_path / "deep" / "er",
        SCALAR,
        (f"{FMUS}/ScalarPlant.fmu", "ScalarPlant"),
        (f"{FMUS}/ScalarController.fmu", "../../fmus/ScalarController.fmu"),
    )
    scenario = load_scenario(file)
    assert component(scenario, "plant").fmu == tmp_path / "fmus" / "ScalarPlant.fmu"


PLANT_FMU = f'"{FMUS}/ScalarPlant.fmu"'
SET_2 = '{"controller.damping" = false}'
METRIC = '{metric = "settling_time", of = "plant.x", below = 0.1}'
PANELS = '["plant.x", "controller.u"]'

MISTAKES = {
    "unknown key": (
        "[experiment]",
        "[experimant]",
        "experimant is not known here; did you mean 'experiment'?",
    ),
    "no title": ('title = "A short loop"', "", "title is missing"),
    "missing FMU by name": (
        PLANT_FMU,
        '"ScalarPlan"',
        "components.plant.fmu = 'ScalarPlan' is no FMU in fmus/; did you mean 'ScalarPlant'? "
        "Or build it with: congelation build SPEC.toml",
    ),
    "missing FMU by path": (PLANT_FMU, '"a/b.fmu"', "components.plant.fmu: no FMU at "),
    "unknown component key": ("start = {x0", "strat = {x0", "components.plant.strat is not known"),
    "component of a taken name": (
        "[components.controller]",
        "[components.experiment]",
        "components.experiment: choose a name other than 'experiment'",
    ),
    "unknown start value": ("k_bar", "k_baar", "did you mean 'k_bar'?"),
    "start value of a wrong type": ("k_bar = 0.5", "k_bar = true", "a number needed"),
    "start value of a wrong shape": ("[1.0]", "[1.0, 2.0]", "2 values given, 1 value needed"),
    "start value of another unit": (
        "k_bar = 0.5",
        'k_bar = {value = 0.5, unit = "m"}',
        "controller.start.k_bar.unit",
    ),
    "unit without a value": ("k_bar = 0.5", 'k_bar = {unit = "1/s"}', "k_bar.value is missing"),
    "profile of no parameter": (
        '"theta[1]"',
        '"theta[2]"',
        "profile.theta[2] is no parameter with a profile; did you mean 'theta[1]'?",
    ),
    "unknown profile term": ("{square", "{sqare", "did you mean 'square'?"),
    "profile term without a value": ("amplitude = 0.4, ", "", "square.amplitude: missing"),
    "too many profile terms": (
        "[{constant = -3.0},",
        "[{chirp = {amplitude = 1, omega_start = 1, omega_end = 2, duration = 1}}, "
        "{chirp = {amplitude = 1, omega_start = 1, omega_end = 2, duration = 1}},",
        "components.plant.profile.theta[1]: terms chirp: 2 given, at most 1 fit",
    ),
    "profile given twice": (
        "{x0 = [1.0]}",
        '{x0 = [1.0], "profile[1].mean" = 1.0}',
        "components.plant.start.profile[1].mean is given by the profile as well",
    ),
    "profile for a controller": (
        "[components.controller]",
        '[components.controller]\nprofile = {"theta[1]" = 1.0}',
        "ScalarController.fmu takes no profile",
    ),
    "connection of no component": ("plant.x ->", "plnt.x ->", "did you mean 'plant'?"),
    "connection of no variable": (
        "-> plant.u",
        "-> plant.what",
        "ScalarPlant.fmu has no variable 'what'; its inputs are: u",
    ),
    "connection of a variable that is spelled otherwise": (
        '"plant.x ->',
        '"plant.thet ->',
        "ScalarPlant.fmu has no variable 'thet'; did you mean 'theta[1]'?",
    ),
    "connection without an arrow": ("plant.x ->", "plant.x to", "connections: connection '"),
    "unknown experiment key": (
        "stop_time",
        "stop_tme",
        "experiment.stop_tme is not known here; did you mean 'stop_time'?",
    ),
    "stop before start": (
        "stop_time = 1.0",
        "stop_time = 1.0\nstart_time = 2.0",
        "experiment.stop_time = 1 is not valid; give a time after start_time = 2",
    ),
    "no step": ("step = 0.01\n", "", "experiment.step is missing"),
    "negative step": ("step = 0.01", "step = -1", "experiment.step = -1 is not valid"),
    "zero tolerance": ("step = 0.01", "tolerance = 0", "experiment.tolerance = 0 is not valid"),
    "time in no unit of time": (
        "step = 0.01",
        'step = {value = 1, unit = "m"}',
        "experiment.step.unit = 'm' is no time",
    ),
    "unknown coupling": (
        "step = 0.01",
        'step = 0.01\ncoupling = "jakobi"',
        "experiment.coupling = 'jakobi' is not known; did you mean 'jacobi'?",
    ),
    "unknown option of a coupling": (
        "step = 0.01",
        'step = 0.01\ncoupling = "derivative"\noptions = {sequenz = "jacobi"}',
        "no option 'sequenz'; did you mean 'sequence'?",
    ),
    "record of no variable": (
        '"controller.theta_hat"]',
        '"controller.theta_hut"]',
        "experiment.record: record 'controller.theta_hut'",
    ),
    "unknown metric": (
        '"settling_time"',
        '"setling_time"',
        "metrics.settling_x.metric: 'setling_time' is no metric; did you mean 'settling_time'?",
    ),
    "metric without its option": (", below = 0.1", "", "metrics.settling_x.below is missing"),
    "metric with another's option": (
        "below = 0.1",
        "below = 0.1, above = 1",
        "metrics.settling_x.above is not known here; did you mean 'below'?",
    ),
    "metric of no variable": (METRIC, METRIC.replace("plant.x", "plant.xx"), "settling_x.of: "),
    "figure without panels": (f"panels = {PANELS}", "", "figures[1].panels is missing"),
    "figure of nothing": (PANELS, "[]", "figures[1].panels = [] is not valid"),
    "figure of no variable": (PANELS, '["plant.y"]', "figures[1].panels: record 'plant.y'"),
    "figure whose name is no file": ('"loop"', '"../loop"', "figures[1].name = '../loop' is not"),
    "figure of no span": (PANELS, f"{PANELS}\nspan = [2, 1]", "figures[1].span = [2, 1] is not"),
    "variants of one name": (
        '"Controller 2"',
        '"Controller 1"',
        "variants[2].name = 'Controller 1' is given twice",
    ),
    "variant of one variable twice": (
        SET_2,
        '{"plant.x0" = [1.0], plant = {x0 = [2.0]}}',
        "variants[2].set.plant.x0 is given twice; leave one of them out",
    ),
    "variant of one profile twice": (
        SET_2,
        '{"plant.profile" = 1, "plant.profile.theta[1]" = 1.0}',
        "variants[2].set.plant.profile is given twice; leave one of them out",
    ),
    "variant of a connected input": (
        SET_2,
        '{"controller.x" = 123}',
        "variants[2].set.controller: 'x' has no effect, as 'plant.x -> controller.x' drives it",
    ),
    "start value of a connected input": (
        "k_bar = 0.5",
        "k_bar = 0.5, x = 123",
        "components.controller.start: 'x' has no effect, as 'plant.x -> controller.x' drives it",
    ),
    "start value of a derivative that the coupling sends": (
        "k_bar = 0.5",
        '"der(x)" = 1, k_bar = 0.5',
        "components.controller.start: 'der(x)' has no effect, as 'plant.x -> controller.x' sets it "
        "along with the value, to 0 where inputs are held; leave one of them out",
    ),
    "infinite start value": (
        "{x0 = [1.0]}",
        "{x0 = [inf]}",
        "components.plant.start, start value 'x0': inf is no value; give a finite number",
    ),
    "start value beyond all numbers": (
        "{x0 = [1.0]}",
        f"{{x0 = [{10**400}]}}",
        "components.plant.start, start value 'x0': inf is no value",
    ),
    "tolerance beyond 1": (
        "step = 0.01",
        "step = 0.01\nslave_tolerance = 1e300",
        "experiment.slave_tolerance = 1e+300 is not valid; give a number between 0 and 1",
    ),
    "infinite step": (
        "step = 0.01",
        'step = {value = 1e308, unit = "h"}',
        "experiment.step = {value = 1e+308, unit = 'h'} is not valid; give a time that is",
    ),
    "option with a unit that is no time": (
        "step = 0.01",
        'step = 0.01\ncoupling = "hermite"\noptions = {tolerance = {value = 0.1, unit = "s"}}',
        "experiment.options.tolerance is no time; give it without a unit",
    ),
    "option without an effect": (
        "step = 0.01",
        'tolerance = 0.01\ncoupling = "hermite"\noptions = {tolerance = 1e-9}',
        "experiment.options.tolerance has no effect beside experiment.tolerance",
    ),
    "metric without a name": ("settling_x =", '"" =', "choose a name other than ''"),
    "metric with a negative option": (
        "below = 0.1",
        "below = -1",
        "metrics.settling_x.below = -1 is not valid; give a positive number",
    ),
    "figures of one name": (
        '[[variants]]\nname = "Controller 1"',
        f'[[figures]]\nname = "loop"\npanels = {PANELS}\n[[variants]]\nname = "Controller 1"',
        "figures[2].name = 'loop' is given twice; names must differ",
    ),
    "figure of no part of the run": (
        PANELS,
        f"{PANELS}\nspan = [2, 3]",
        "figures[1].span = [2, 3] is not valid; give a part of the time from 0 to 1",
    ),
    "variant of no component": (
        SET_2,
        '{"contoller.damping" = false}',
        "variants[2].set.contoller is no component; did you mean 'controller'?",
    ),
    "variant of no variable": (
        SET_2,
        '{"controller.dampng" = false}',
        "variants[2].set.controller, start value 'dampng': ",
    ),
    "variant of no owner": (SET_2, "{damping = false}", "variants[2].set.damping is no setting"),
    "variant of a wrong experiment": (
        SET_2,
        '{"experiment.step" = 0}',
        "variants[2].set.experiment.step = 0 is not valid; give a positive time",
    ),
    "variant of the record": (
        SET_2,
        '{"experiment.record" = []}',
        "variants[2].set.experiment.record is not known here",
    ),
}


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes_are_told_with_their_place(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    file = write(tmp_path, SCALAR, (old, new))
    if "ScalarPlan" in message:
        (tmp_path / "fmus").symlink_to(FMUS)
    with pytest.raises(InvalidInput) as told:
        load_scenario(file)
    text = str(told.value)
    assert text.startswith(f"{file}: ")
    assert message in text
    assert "\n" not in text


def test_start_values_of_derivatives_have_no_effect_where_inputs_are_held() -> None:
    """That is why scenarios refuse them under each coupling."""
    ends = [
        simulate(
            System(
                (
                    Component("plant", FMUS / "ScalarPlant.fmu", {"x0": [1.0]}),
                    Component("controller", FMUS / "ScalarController.fmu", start),
                ),
                ("plant.x -> controller.x", "controller.u -> plant.u"),
            ),
            stop_time=0.1,
            step=0.05,
            coupling="jacobi",
        ).values[-1]
        for start in ({}, {"der(x)": 100.0})
    ]
    assert ends[0].tolist() == ends[1].tolist()


def test_without_any_fmu_the_build_command_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # A temporary folder may lie below one with FMUs.
    monkeypatch.setattr(Path, "parents", property(lambda self: (tmp_path,)))
    with pytest.raises(InvalidInput) as told:
        load_scenario(write(tmp_path, SCALAR, (PLANT_FMU, '"ScalarPlant"')))
    assert str(told.value).endswith(
        "is no FMU in fmus/; build it with: congelation build SPEC.toml"
    )


def test_of_a_missing_fmu_the_spec_beside_is_named_that_builds_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Path, "parents", property(lambda self: (tmp_path,)))
    for folder in ("fmus", "specs"):
        (tmp_path / folder).mkdir()
    (tmp_path / "fmus" / "F16PitchPlant.fmu").touch()
    file = write(tmp_path, SCALAR, (PLANT_FMU, '"StrictFeedbackPlant"'))
    for spec, remedy in (
        ("bad = [", "SPEC.toml"),
        ((ROOT / "specs" / "state_feedback.toml").read_text(), "'specs/the plant.toml'"),
    ):
        (tmp_path / "specs" / "the plant.toml").write_text(spec)
        with pytest.raises(InvalidInput) as told:
            load_scenario(file)
        assert str(told.value) == (
            f"{file}: components.plant.fmu = 'StrictFeedbackPlant' is no FMU in fmus/; build it "
            f"with: congelation build {remedy}"
        )


def test_a_sample_time_may_state_its_unit(tmp_path: Path) -> None:
    sampled = 'step = 0.01\ncoupling = "sampled"\noptions = '
    for time in ("0.02", '{value = 20, unit = "ms"}'):
        change = ("step = 0.01", f"{sampled}{{sample_time = {time}}}")
        scenario = load_scenario(write(tmp_path, SCALAR, change))
        assert scenario.case({}).experiment.options == {"sample_time": 0.02}


def test_a_linked_scenario_is_read_from_where_it_leads(tmp_path: Path) -> None:
    """The FMUs and tables beside the file itself are found from a link in another folder."""
    home, away = tmp_path / "home", tmp_path / "away"
    (home / "fmus").mkdir(parents=True)
    away.mkdir()
    for fmu in ("ScalarPlant", "ScalarController"):
        shutil.copy(FMUS / f"{fmu}.fmu", home / "fmus")
    (home / "theta.csv").write_text("time,value\n0,-3\n1,-2\n")
    file = write(
        home,
        SCALAR,
        (f"{FMUS}/ScalarPlant.fmu", "ScalarPlant"),
        (f"{FMUS}/ScalarController.fmu", "fmus/ScalarController.fmu"),
        ("{constant = -3.0}", '{table = {file = "theta.csv"}}'),
    )
    link = away / "linked.toml"
    link.symlink_to(file)
    found = load_scenario(link).system.components
    assert [c.fmu for c in found] == [c.fmu for c in load_scenario(file).system.components]
    assert found[0].start == load_scenario(file).system.components[0].start
    # What is beside the link comes first.
    (away / "fmus").mkdir()
    shutil.copy(FMUS / "ScalarPlant.fmu", away / "fmus")
    assert load_scenario(link).system.components[0].fmu == away / "fmus" / "ScalarPlant.fmu"
    (away / "gone.toml").symlink_to(away / "nothing.toml")
    with pytest.raises(InvalidInput, match=r"this is a link to .*nothing\.toml, which does not ex"):
        load_scenario(away / "gone.toml")


def test_a_name_that_is_too_long_for_a_file_is_refused(tmp_path: Path) -> None:
    file = write(tmp_path, SCALAR, ('name = "loop"', f'name = "{"x" * 201}"'))
    with pytest.raises(InvalidInput, match=r"figures\[1\]\.name.*give up to 200 letters, digits"):
        load_scenario(file)


def test_an_axis_and_what_is_given_exclude_each_other(tmp_path: Path) -> None:
    axis = '\n[sweep]\n[[sweep.axes]]\nset = "experiment.stop_time"\nvalues = [0.5, 1.0]\n'
    scenario = load_scenario(write(tmp_path, SCALAR + axis), {"stop_time": 0.3})
    with pytest.raises(InvalidInput, match=r"experiment\.stop_time is what an axis of the sweep"):
        sweep(scenario, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
