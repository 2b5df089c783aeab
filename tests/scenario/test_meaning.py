"""What a scenario means: units of start values, and connections that were forgotten."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest
from typer.testing import CliRunner

from congelation.cli import app
from congelation.errors import InvalidInput
from congelation.results.provenance import about
from congelation.results.results import open_results
from congelation.scenario.load import load_scenario
from tests.cosim.test_units import with_units
from tests.scenarios import FMUS, SCALAR, write
from tests.studies import command

LINK = '"plant.x -> controller.x", '


def scenario_with(folder: Path, units: dict[str, str], *changes: tuple[str, str]) -> Path:
    fmu = with_units(folder, "ScalarPlant", units)
    return write(folder, SCALAR, (f"{FMUS}/ScalarPlant.fmu", str(fmu)), *changes)


@pytest.mark.parametrize(
    ("unit", "value", "given", "expected"),
    [
        ("K", "20", "degC", 293.15),
        ("K", "68", "degF", 293.15),
        ("degC", "293.15", "K", 20.0),
        ("km/h", "10", "m/s", 36.0),
        ("m/s", "36", "km/h", 10.0),
        ("deg", "1", "rad", 57.29577951308232),
        ("K", "[20]", "degC", 293.15),
    ],
)
def test_start_values_are_given_in_any_unit_of_their_kind(
    tmp_path: Path, unit: str, value: str, given: str, expected: float
) -> None:
    start = f'{{x0 = {{value = {value}, unit = "{given}"}}}}'
    file = scenario_with(tmp_path, {"x": unit, "x0[1]": unit}, ("{x0 = [1.0]}", start))
    plant = load_scenario(file).system.components[0]
    assert plant.start["x0[1]"] == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (
            '{value = 1, unit = "m"}',
            "start.x0.unit = 'm' is not the unit of 'x0': 'm' cannot become 'K': m against K in SI "
            "units; give one such as 'K'",
        ),
        (
            '{value = 1, unit = "furlong"}',
            "start.x0.unit = 'furlong' is not the unit of 'x0'; give",
        ),
        ('{value = true, unit = "degC"}', "start.x0.value = true is not valid; give a number"),
        (
            '[{value = 1, unit = "degC"}]',
            "start.x0 has an element with a unit of its own; give each element by name, "
            '"x0[1]" = {value = .., unit = ".."}, or one unit for all, '
            'x0 = {value = [..], unit = ".."}',
        ),
        ('{value = "1", unit = "degC"}', "start.x0.value = '1' is not valid; give a number"),
    ],
)
def test_other_units_are_refused(tmp_path: Path, start: str, message: str) -> None:
    file = scenario_with(tmp_path, {"x0[1]": "K"}, ("{x0 = [1.0]}", f"{{x0 = {start}}}"))
    with pytest.raises(InvalidInput) as told:
        load_scenario(file)
    assert f"{file}: components.plant.{message}" in str(told.value)


def test_a_connection_of_other_base_units_is_refused(tmp_path: Path) -> None:
    controller = with_units(tmp_path, "ScalarController", {"u": "rad"})
    change = (f"{FMUS}/ScalarController.fmu", str(controller))
    file = scenario_with(tmp_path, {"u": "K"}, change)
    with pytest.raises(InvalidInput) as told:
        load_scenario(file)
    assert str(told.value).startswith(f"{file}: connection 'controller.u -> plant.u': ")
    assert "cannot become 'K'" in str(told.value)


def test_a_unit_on_one_side_is_a_warning(tmp_path: Path) -> None:
    file = scenario_with(tmp_path, {"x": "K"})
    (warning,) = load_scenario(file).warnings
    assert warning == (
        f"{file}: connection 'plant.x -> controller.x': the input states no unit, the other end 'K'"
    )


def test_a_forgotten_connection_is_named(tmp_path: Path) -> None:
    file = write(tmp_path, SCALAR, (LINK, ""))
    (warning,) = load_scenario(file).warnings
    assert warning == (
        f"{file}: input 'controller.x' has no connection and no start value; "
        'connect it, set it, or list it in open = ["controller.x"]'
    )


@pytest.mark.parametrize(
    "change",
    [
        ("k_bar = 0.5", "k_bar = 0.5, x = 1.0"),
        ('title = "A short loop"', 'title = "A short loop"\nopen = ["controller.x"]'),
        ('"controller.damping" = false', '"controller.damping" = false, "controller.x" = 1.0'),
        (
            "[[figures]]",
            '[sweep]\n[[sweep.axes]]\nset = "controller.x"\nvalues = [1.0, 2.0]\n[[figures]]',
        ),
    ],
)
def test_an_input_that_is_set_or_left_open_is_not(tmp_path: Path, change: tuple[str, str]) -> None:
    assert load_scenario(write(tmp_path, SCALAR, (LINK, ""), change)).warnings == ()


def test_a_metric_of_times_after_the_end_is_named(tmp_path: Path) -> None:
    change = ('{metric = "peak", of = "plant.x"}', '{metric = "peak", of = "plant.x", after = 2.0}')
    file = write(tmp_path, SCALAR, change)
    (warning,) = load_scenario(file).warnings
    assert warning == (
        f"{file}: metrics.peak_x.after = 2 is past stop_time = 1: the metric has no value"
    )
    axis = '[sweep]\n[[sweep.axes]]\nset = "experiment.stop_time"\nvalues = [1.0, 3.0]\n[[figures]]'
    assert load_scenario(write(tmp_path, SCALAR, change, ("[[figures]]", axis))).warnings == ()


def test_a_step_longer_than_the_run_is_named(tmp_path: Path) -> None:
    change = ("step = 0.01", "step = 1.5")
    file = write(tmp_path, SCALAR, change)
    (warning,) = load_scenario(file).warnings
    assert (
        warning == f"{file}: experiment.step = 1.5 is longer than the run, 1 s, which is one step"
    )
    first = ("step = 0.01", "step = 1.5\ntolerance = 1e-4")  # the first step is tried
    assert load_scenario(write(tmp_path, SCALAR, first)).warnings == ()


def test_more_rows_than_a_machine_keeps_are_refused(tmp_path: Path) -> None:
    change = ("step = 0.01", "step = 0.01\noutput_interval = 1e-9")
    with pytest.raises(
        InvalidInput, match="output_interval = 1e-09 asks for 1e\\+09 rows of a run"
    ):
        load_scenario(write(tmp_path, SCALAR, change))


def test_shipped_fmus_say_which_inputs_are_left_alone(tmp_path: Path) -> None:
    """der(.) and dtheta are optional: nothing is said of them."""
    assert load_scenario(write(tmp_path)).warnings == ()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("controller.y", "open: input 'controller.y': "),
        ("plant.x", "open: 'plant.x' is of causality output, no input"),
        ("plant.u", "open: 'plant.u' is driven by 'controller.u -> plant.u'; leave one of them"),
    ],
)
def test_open_names_inputs(tmp_path: Path, name: str, message: str) -> None:
    title = 'title = "A short loop"'
    with pytest.raises(InvalidInput) as told:
        load_scenario(write(tmp_path, SCALAR, (title, f'{title}\nopen = ["{name}"]')))
    assert message in str(told.value)


@pytest.mark.parametrize("command", ["run", "sweep"])
def test_strict_takes_warnings_for_errors(tmp_path: Path, command: str) -> None:
    axis = '[sweep]\n[[sweep.axes]]\nset = "controller.gamma"\nvalues = [1.0]\n[[figures]]'
    file = write(tmp_path, SCALAR, (LINK, ""), ("[[figures]]", axis))
    out = ("--out", str(tmp_path / "out"))
    done = CliRunner().invoke(app, [command, str(file), *out, "--strict"])
    assert isinstance(done.exception, InvalidInput)
    assert str(done.exception).startswith(f"{file}: input 'controller.x' has no connection")
    done = CliRunner().invoke(app, [command, str(file), *out])
    assert f"warning: {file}: input 'controller.x'" in done.stderr


@pytest.mark.parametrize(("second", "unit"), [("rad", ""), ("K", "K^2 s")])
def test_a_metric_of_mixed_units_has_none(tmp_path: Path, second: str, unit: str) -> None:
    plant = with_units(tmp_path, "StrictFeedbackPlant", {"theta[1]": "K", "theta[2]": second})
    file = write(
        tmp_path,
        SCALAR,
        (f"{FMUS}/ScalarPlant.fmu", str(plant)),
        (f"{FMUS}/ScalarController.fmu", str(FMUS / "StateFeedbackController.fmu")),
        ("{x0 = [1.0]}", "{x0 = [1.0, 0.0]}"),
        ("{k_bar = 0.5, epsilon = 0.3}", "{}"),
        (
            "[metrics]",
            '[metrics]\nsquared = {metric = "ise", of = "plant.theta"}\n'
            'settled = {metric = "settling_time", of = "plant.theta", below = 1}',
        ),
    )
    found = about(load_scenario(file), ())["metrics"]
    assert found["squared"]["unit"] == unit
    assert found["settled"]["unit"] == "s"


def test_a_metric_of_times_before_the_start_is_named(tmp_path: Path) -> None:
    old = 'peak_x = {metric = "peak", of = "plant.x"}'
    file = write(tmp_path, SCALAR, (old, old.replace("}", ", after = -1}")))
    assert load_scenario(file).warnings == (
        f"{file}: metrics.peak_x.after = -1 is before start_time = 0: it has no effect",
    )


def test_a_sampling_of_nothing_is_refused(tmp_path: Path) -> None:
    axis = '[sweep]\nsampling = "sobol"\n[[sweep.axes]]\nset = "controller.gamma"\nvalues = [1.0]\n'
    with pytest.raises(InvalidInput, match=r"sampling has no meaning without a random axis"):
        load_scenario(write(tmp_path, SCALAR, ("[[figures]]", f"{axis}[[figures]]")))


def test_a_norm_over_different_units_is_named(tmp_path: Path) -> None:
    plant = with_units(tmp_path, "StrictFeedbackPlant", {"x[1]": "m", "x[2]": "K"})
    file = tmp_path / "s.toml"
    file.write_text(
        f'title = "s"\nopen = ["p.u"]\n[components.p]\nfmu = "{plant}"\n'
        "[experiment]\nstop_time = 1\nstep = 0.1\n"
        '[metrics]\nboth = {metric = "peak", of = "p.x"}\none = {metric = "peak", of = "p.x[1]"}\n',
        encoding="utf-8",
    )
    (line,) = load_scenario(file).warnings
    assert line.startswith(f"{file}: metrics.both: 'p.x' has elements in 'K', 'm', whose norm")


@pytest.mark.parametrize(("unit", "announces"), [("s", True), ("", True), ("ms", False)])
def test_announcements_are_in_seconds(tmp_path: Path, unit: str, announces: bool) -> None:
    file = scenario_with(tmp_path, {"next_event": unit})
    scenario = load_scenario(file)
    line = f"{file}: 'plant.next_event' is in 'ms', not in 's'; it is not taken for"
    assert [w.startswith(line) for w in scenario.warnings] == [True] * (not announces)
    plant = scenario.system.resolve().members[0]
    assert plant.name == "plant"
    assert (plant.description.announcement is not None) is announces


@pytest.mark.parametrize(
    ("unit", "option", "equal"),
    [
        ("m", 'below = {value = 100, unit = "mm"}', "below = 0.1"),
        ("degC", 'below = {value = 273.25, unit = "K"}', "below = 0.1"),
        ("K", 'reference = {value = -272.65, unit = "degC"}', "reference = 0.5"),
        ("m", 'after = {value = 500, unit = "ms"}', "after = 0.5"),
    ],
)
def test_options_of_metrics_state_units(tmp_path: Path, unit: str, option: str, equal: str) -> None:
    """A metric with the option in a unit of its own is that with one in the variable's."""
    name = option.partition(" ")[0]
    metric = {"below": "settling_time", "reference": "overshoot", "after": "peak"}[name]
    texts = [f'{{metric = "{metric}", of = "plant.x", {given}}}' for given in (option, equal)]
    old = '{metric = "settling_time", of = "plant.x", below = 0.1}'
    change = (old, f"{texts[0]}\nsame = {texts[1]}")
    file = scenario_with(tmp_path, {"x": unit, "x0[1]": unit}, change)
    assert command("run", file, "--out", tmp_path / "out", "--progress", "quiet").returncode == 0
    row = next(iter(open_results(tmp_path / "out").runs.rows()))
    assert row["metric.settling_x"] == pytest.approx(row["metric.same"], rel=1e-9)
    assert 0.0 < row["metric.same"] < 1.0


@pytest.mark.parametrize(
    ("metric", "message"),
    [
        (
            'metric = "settling_time", of = "plant.x", below = {value = 1, unit = "s"}',
            "below.unit = 's' is not the unit of 'below': 's' cannot become 'm'",
        ),
        (
            'metric = "settling_time", of = "plant.x", below = {value = -1, unit = "mm"}',
            "a positive number",
        ),
        (
            'metric = "peak", of = "plant.x", after = {value = 1, unit = "m"}',
            "after.unit = 'm' is no time",
        ),
    ],
)
def test_options_of_metrics_in_other_units_are_refused(
    tmp_path: Path, metric: str, message: str
) -> None:
    old = 'metric = "settling_time", of = "plant.x", below = 0.1'
    with pytest.raises(InvalidInput) as told:
        load_scenario(scenario_with(tmp_path, {"x": "m"}, (old, metric)))
    assert message in str(told.value)


@pytest.mark.parametrize(
    ("term", "doubt"),
    [
        ("square = {amplitude = 0.4, period = 1e-9}", "square[1].period' = 1e-09 makes 1e+09"),
        ("sine = {amplitude = 0.4, omega = 1e300}", "sine[1].omega' = 1e+300 makes 1.6e+299"),
        ("telegraph = {amplitude = 1, rate = 1e9, seed = 1}", "rate' = 1e+09 makes 1e+09"),
        ("square = {amplitude = 0.0, period = 1e-9}", ""),
        ("square = {amplitude = 0.4, period = 1e-7}", ""),
    ],
)
def test_a_profile_that_no_steps_resolve_is_named(tmp_path: Path, term: str, doubt: str) -> None:
    file = write(tmp_path, SCALAR, ("square = {amplitude = 0.4, period = 0.3}", term))
    assert [doubt in warning for warning in load_scenario(file).warnings] == [True] * bool(doubt)


def test_an_axis_that_leaves_the_range_of_a_variable_is_named(tmp_path: Path) -> None:
    """Of lists each value, of random axes the ends of their range."""
    fmu = tmp_path / "Bounded.fmu"
    with zipfile.ZipFile(FMUS / "ScalarPlant.fmu") as old, zipfile.ZipFile(fmu, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                place = data.index(b"<Real", data.index(b'name="x0[1]"'))
                data = data[:place] + b'<Real max="5"' + data[place + len(b"<Real") :]
            new.writestr(name, data)
    axes = (
        "[sweep]\nsamples = 2\n[[sweep.axes]]\nset = 'plant.x0[1]'\n{}\n[[figures]]",
        "'plant.x0[1]' = 7, where its FMU states max = 5",
    )
    for axis in ("uniform = [1, 7]", "values = [1, 7]"):
        text = axes[0].format(axis)
        text = text if "uniform" in axis else text.replace("samples = 2\n", "")
        change = (f"{FMUS}/ScalarPlant.fmu", str(fmu))
        file = write(tmp_path, SCALAR, change, ("[[figures]]", text))
        (warning,) = load_scenario(file).warnings
        assert warning == f"{file}: sweep: {axes[1]}"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            '"A short loop"',
            '"A short\\nloop"',
            "title = 'A short loop' is not valid; give characters that",
        ),
        ('"Controller 1"', '"\\u001b[31mred"', "variants[1].name = '"),
        ("peak_x = {", '"a\\u0007" = {', "choose a name other than 'a"),
    ],
)
def test_names_that_a_terminal_would_obey_are_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    with pytest.raises(InvalidInput) as told:
        load_scenario(write(tmp_path, SCALAR, (old, new)))
    assert message in str(told.value)


@pytest.mark.parametrize("source", ["variant 'Controller 1'", "sweep"])
def test_a_number_of_a_term_that_the_profile_lacks_is_named(tmp_path: Path, source: str) -> None:
    name = "plant.profile.theta[1].sine.omega"
    change = ('set = {"controller.damping" = true}', f'set = {{"{name}" = 3.0}}')
    if source == "sweep":
        axis = f"[sweep]\n[[sweep.axes]]\nset = '{name}'\nvalues = [3.0]\n[[figures]]"
        change = ("[[figures]]", axis)
    file = write(tmp_path, SCALAR, change)
    (warning,) = load_scenario(file).warnings
    assert warning == (
        f"{file}: {source}: 'plant.profile[1].sine[1].omega' has no effect, as the profile has no "
        "such term: 'plant.profile[1].sine[1].amplitude' is 0"
    )


def test_a_term_that_the_fmu_has_by_default_is_no_doubt(tmp_path: Path) -> None:
    """The spec of StrictFeedbackPlant has a sine of amplitude 0.6 in theta_1."""
    axis = "[[sweep.axes]]\nset = 'plant.profile[1].sine[1].omega'\nvalues = [0.1, 3.0]\n"
    file = tmp_path / "default.toml"
    file.write_text(
        'title = "t"\nconnections = ["plant.x -> controller.x", "controller.u -> plant.u"]\n'
        f'[components.plant]\nfmu = "{FMUS / "StrictFeedbackPlant.fmu"}"\n'
        f'[components.controller]\nfmu = "{FMUS / "StateFeedbackController.fmu"}"\n'
        "[experiment]\nstop_time = 1.0\nstep = 0.1\n" + axis
    )
    assert load_scenario(file).warnings == ()


def test_sizes_of_a_profile_are_in_the_unit_of_theta(tmp_path: Path) -> None:
    scenario = load_scenario(scenario_with(tmp_path, {"theta[1]": "1/s"}))
    prefix = "plant.profile[1]"
    varied = [f"{prefix}.{name}" for name in ("mean", "square[1].amplitude", "square[1].period")]
    units = about(scenario, [*varied, f"{prefix}.telegraph[1].seed"])["units"]
    assert units == dict(zip(varied, ("1/s", "1/s", "s"), strict=True))
