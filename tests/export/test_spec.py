"""Specs: what is read, and what is said of a mistake."""

import os
import re
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

import build_fmu
from congelation.errors import InvalidInput
from congelation.export.interface import interface_of
from congelation.export.spec import read_buildable, read_spec
from congelation.export.spec_assumptions import spec_warnings
from tests.scenarios import FMUS

ROOT = Path(__file__).resolve().parents[2]
GOOD = """
form = "strict-feedback"
[structure]
n = 2
p = 1
phibar = {"1,1" = [1], "2,2" = [0.5]}
[plant]
name = "P"
start = {x0 = [1, 0]}
[plant.profile]
"theta[1]" = [{constant = 1}]
[controller]
name = "C"
start = {c = [1, 2]}
"""

# Whole numbers have no bound in TOML as Python reads it.
HUGE = "1" + 400 * "0"


def exit_code(*arguments):
    """That of build_fmu.py."""
    with pytest.raises(SystemExit) as ended:
        build_fmu.main([str(argument) for argument in arguments])
    return ended.value.code


def read(folder, text):
    file = folder / "spec.toml"
    file.write_text(text)
    return read_spec(file)


def test_good(tmp_path):
    spec = read(tmp_path, GOOD)
    assert spec.plant.model.states[0].start == (1.0, 0.0)
    assert spec.controller.model.parameters[0].default == (1.0, 2.0)
    assert spec.structure["phibar"] == [[[1.0], [0.0]], [[0.0], [0.5]]]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"strict-feedback"', '"strict-feedbac"', "form = 'strict-feedbac' is not known"),
        ("p = 1", "q = 1", "structure.q is not known here; .*'p'|valid"),
        ('"2,2" = [0.5]', '"1,2" = [0.5]', "structure.phibar.1,2 is not known"),
        ('"2,2" = [0.5]', '"2,2" = [0.5, 1]', "structure.phibar.2,2 .* give 1 number$"),
        ("c = [1, 2]", "c = [1]", "c = .1. is not valid; give 2 numbers"),
        ("c = [1, 2]", "d = [1, 2]", "d is not known"),
        ('name = "C"', 'name = "my C"', "controller.name = 'my C' is not valid"),
        ('"theta[1]"', '"theta[2]"', "plant.profile.theta.2. is not known"),
        ("{constant = 1}", "{constnat = 1}", "constnat"),
        ("[structure]", "[structur]", "structur is not known"),
        ('name = "C"', 'name = "p"', "controller.name = 'p' is the plant's too"),
        ("c = [1, 2]", "epsilon = 1e-300", "controller.start: epsilon = 1e-300 cannot be used"),
        (
            "c = [1, 2]",
            "c = [1, 2], delta = 1e300",
            ": delta = 1e.300 cannot be used: .* would not be finite",
        ),
        ("c = [1, 2]", f"c = [1, {HUGE}]", "controller.start: c = .1, 1000.* is not valid"),
        ("x0 = [1, 0]", f"x0 = [{HUGE}, 0]", "plant.start: x0 = .* is not valid"),
        ("constant = 1", f"constant = {HUGE}", "must be a finite number"),
        ('"1,1" = [1]', f'"1,1" = [{HUGE}]', "structure.phibar.1,1 .* give 1 number$"),
        ("n = 2", f"n = {HUGE}", "structure.n .* a whole number from 0 to 100"),
        ("p = 1", "p = 1000000", "structure.p = 1000000 .* a whole number from 0 to 100"),
        ("p = 1", f"p = {'1' * 5000}", "not valid TOML"),
        ("[plant]", f'[units]\nu = "deg{HUGE}"\n[plant]', "is no unit"),
    ],
)
def test_mistakes(tmp_path, old, new, message):
    assert old in GOOD
    with pytest.raises((InvalidInput, ValueError), match=message) as caught:
        read(tmp_path, GOOD.replace(old, new))
    assert "\n" not in str(caught.value)
    assert re.search(r"spec\.toml", str(caught.value))


def test_infeasible_gains_are_refused(tmp_path, capsys):
    """The values of Sec. V, (r, epsilon) = (5, 0.1): no FMU, and the smallest r that works."""
    text = (ROOT / "specs" / "output_feedback.toml").read_text("utf-8")
    changed = re.sub(r"epsilon = [0-9.]+", "epsilon = 0.1", text)
    assert changed != text
    file = tmp_path / "infeasible.toml"
    file.write_text(changed)
    assert exit_code("--spec", file, "--out", tmp_path) == 2
    assert "the smallest feasible r is 10.0499" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.fmu"))


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (
            "r = 1e300, epsilon = 0.3",
            "r = 1e.300, epsilon = 0.3.* would not be finite at the start",
        ),
        ("r = 5, epsilon = 1e-300", "k cannot be computed from r = 5.0, epsilon = 1e-300"),
        (
            "epsilon = 0.1",
            "it is left out, and so r = 3 is infeasible .* smallest feasible r is 10.0499 "
            r".docs/theory\.md, 'The ISS K-filter'.",
        ),
        ("r = 5, epsilon = 1e300", "the weight Q of .41. leaves the range of floats"),
        ("r = 5, epsilon = 1e-100", "up to 1e.12 that double precision could hold"),
    ],
)
def test_gains_out_of_reach_are_one_line(tmp_path, start, message):
    text = (ROOT / "specs" / "output_feedback.toml").read_text("utf-8")
    changed = re.sub(r"r = 5, epsilon = [0-9.]+", start, text)
    assert changed != text
    with pytest.raises(InvalidInput, match=message) as caught:
        read(tmp_path, changed)
    assert "\n" not in str(caught.value)


def test_two_specs_of_equal_names_are_refused(tmp_path, capsys):
    file = str(ROOT / "specs" / "scalar.toml")
    assert exit_code("--spec", file, "--spec", file, "--out", tmp_path) == 2
    assert "'ScalarPlant' is an FMU of spec 'scalar' too" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.fmu"))


def test_a_place_that_takes_no_files_is_one_line(tmp_path, capsys):
    spec = str(ROOT / "specs" / "scalar.toml")
    (tmp_path / "file").touch()
    for place in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/x")):
        assert exit_code("--spec", spec, "--out", place) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"congelation: --out {place}: no files can be written there")


def test_a_foreign_manifest_is_one_line(tmp_path, capsys):
    (tmp_path / "manifest.json").write_text("[]")
    spec = str(ROOT / "specs" / "scalar.toml")
    assert exit_code("--spec", spec, "--out", tmp_path) == 2
    assert "manifest.json was not written by `congelation build`" in capsys.readouterr().err


def test_a_python_without_the_packages_is_told_what_to_do():
    """-S leaves out what is installed, as a system's Python would be without it."""
    done = subprocess.run(
        [sys.executable, "-S", str(ROOT / "build_fmu.py")],
        env={"PATH": os.environ["PATH"]},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "has no module '" in line
    assert "make fmus" in line


def test_command(tmp_path, capsys):
    assert exit_code("--spec", tmp_path / "none.toml") == 2
    assert "no such file" in capsys.readouterr().err


OBSERVER = 'form = "observer"\n[structure]\nn = 2\nm = 0\n[units]\n'
MATCHED = 'form = "matched"\n[structure]\nA = [[0, 1], [0, 0]]\nB = [0, 1]\n[units]\n'
STRICT = 'form = "strict-feedback"\n[structure]\nn = 2\np = 1\nphibar = {"2,1" = [-1]}\n[units]\n'
VARYING = STRICT.replace("[units]", 'gain = "varying"\n[units]')
TRACKING = STRICT.replace("[units]", "tracking = true\n[units]")
NONLINEAR = STRICT.replace('phibar = {"2,1" = [-1]}', 'phi = {1 = ["x[1]**2"]}')
SCALAR = 'form = "scalar"\n[units]\n'
REFERENCE = 'form = "reference"\n[structure]\nn = 2\n[units]\n'
DELAY = 'form = "delay"\n[units]\n'


@pytest.mark.parametrize(
    ("text", "place", "unit"),
    [
        # y'' = b u - a_1 y' - a_0 y
        (
            OBSERVER + 'theta = "1/s"\ny = "m"\nu = "N"',
            "theta = '1/s'",
            "theta[1] the unit 'm/s2/N'",
        ),
        (
            OBSERVER + 'theta = ["m/s2/N", "1/s2", "1/s2"]\ny = "m"\nu = "N"',
            "theta = '1/s2'",
            "theta[2] the unit '1/s'",
        ),
        (OBSERVER + 'theta = ["V", "1/s", "1/s"]', "theta = '1/s'", "theta[3] the unit '1/s2'"),
        (OBSERVER + 'y = "m"\nx = ["m", "m"]', "x = 'm'", "x[2] the unit 'm/s'"),
        (OBSERVER + 'y = "m"\nx = ["km", "km/s"]', "x = 'km'", "x[1] the unit 'm'"),
        (OBSERVER + 'y = "m"\nu = "N"\nrho_hat = "1"', "rho_hat = '1'", "the unit 'N.s2/m'"),
        (OBSERVER + 'y = "m"\nu = "N"\nz = ["m", "m/s"]', "z = 'm/s'", "z[2] the unit 'N.s'"),
        # x_2' = u + theta_1 x_1 + theta_2 x_2, with B and A in units of their own
        (
            MATCHED + 'x = ["m", "m/s"]\nu = "N"\ntheta = "1/s"',
            "theta = '1/s'",
            "theta[1] the unit 'N/m'",
        ),
        (MATCHED + 'x = ["deg", "rad/s"]', "x = 'rad/s'", "x[2] the unit 'deg/s'"),
        (STRICT + 'x = ["m", "m/s"]\nu = "N"', "u = 'N'", "give the unit 'm/s2'"),
        (STRICT + 'theta = "1/s"', "theta = '1/s'", "theta[1] the unit '1/s2'"),
        (STRICT + 'x = ["A", "V"]', "x = 'V'", "x[2] the unit 'A/s'"),
        (STRICT + 'x = ["A", "A/s"]\nz = ["A", "A"]', "z = 'A'", "z[2] the unit 'A/s'"),
        (
            VARYING + 'x = ["m", "m/s"]\nu = "kN"\ntheta = "1/s2"',
            "'1/s2'",
            "theta[2] the unit 'm/s2/kN'",
        ),
        (TRACKING + 'x = ["m", "m/s"]\nyr = "m"', "yr = 'm'", "yr[1] the unit 'm/s'"),
        (
            NONLINEAR + 'x = ["m", "m/s"]\ntheta = "1/s"',
            "theta = '1/s'",
            "theta[1] the unit '1/m/s'",
        ),
        (SCALAR + 'x = "m"\nu = "N"', "u = 'N'", "give the unit 'm/s'"),
        (SCALAR + 'theta = "1/min"', "theta = '1/min'", "theta[1] the unit '1/s'"),
        (REFERENCE + 'yr = ["m", "m/s", "m/s"]', "yr = 'm/s'", "yr[2] the unit 'm/s2'"),
        (DELAY + 'u = "m"\ny = "s"', "y = 's'", "y[1] the unit 'm'"),
    ],
)
def test_units_that_the_equations_do_not_admit(tmp_path, text, place, unit):
    file = tmp_path / "spec.toml"
    file.write_text(text)
    with pytest.raises(InvalidInput) as refused:
        read_buildable(file)
    line = str(refused.value)
    assert line.startswith(f"{file}: units.")
    assert place in line
    assert line.endswith(unit)
    assert " does not fit the equation " in line


@pytest.mark.parametrize(
    "text",
    [
        OBSERVER + 'theta = ["m/s2/N", "1/s", "1/s2"]\ny = "m"\nu = "N"\nx = ["m", "m/s"]',
        OBSERVER + 'theta = ["rad/s2/V", "1/s", "1/s2"]\ny = "deg"\nu = "V"'.replace("rad", "deg"),
        OBSERVER + 'y = "m"\nu = "N"',
        MATCHED + 'x = ["rad", "1/s"]\nu = "N.m"\ntheta = ["N.m", "N.m.s"]',
        STRICT + 'x = ["m", "m/s"]\nu = "N/kg"\ntheta = "1/s2"',
        STRICT.replace("-1", "9.81") + 'x = ["m", "m/s"]\ntheta = "1/m"',  # 9.81 m/s2
        VARYING + 'x = ["m", "m/s"]\nu = "kN"\ntheta = ["1/s2", "1/t"]',
        NONLINEAR.replace("x[1]**2", "sin(x[1])") + 'x = ["rad", "rad/s"]\ntheta = "1/s"',
        NONLINEAR.replace("x[1]**2", "9.81*x[1]") + 'x = ["m", "m/s"]\ntheta = "s/m"',
        SCALAR + 'x = "Pa"\nu = "N/m2/s"\ntheta = "Hz"',
        REFERENCE + 'yr = ["m", "m/s", "m/s2"]\nr = "m"',
    ],
)
def test_units_that_the_equations_admit(tmp_path, text):
    file = tmp_path / "spec.toml"
    file.write_text(text)
    fmus = read_buildable(file).fmus
    stated = [u for fmu in fmus for i in fmu.model.inputs for u in i.variables.units if u]
    stated += [u for fmu in fmus for y in fmu.model.outputs for u in y.variables.units if u]
    assert stated


def test_what_a_reference_is_measured_in(tmp_path):
    """Its amplitudes, its filter and derivatives have units that follow from that of yr[0]."""
    file = tmp_path / "reference.toml"
    file.write_text(REFERENCE + 'yr = ["rad", "rad/s", "rad/s2"]\n[block]\nname = "R"\n')
    fmu = read_buildable(file).fmus[0]
    units = {v.name: v.unit for v in interface_of(fmu.model, fmu.profiles).variables}
    assert {units[name] for name in ("offset", "amplitude[1]", "r", "q0[0]")} == {"rad"}
    assert [units[name] for name in ("q0[1]", "der(yr[1])", "der(yr[2])")] == [
        "rad/s",
        "rad/s2",
        "rad/s3",
    ]


def test_the_page_of_an_fmu_has_the_paragraphs_that_concern_it():
    """Those of options that it lacks are left out, and its plant's equations are written out."""
    with ZipFile(FMUS / "ActiveSuspensionPlant.fmu") as archive:
        plant = archive.read("documentation/index.html").decode()
    assert "&theta;<sub>3</sub> u &minus; &theta;<sub>1</sub> x<sub>1</sub>" in plant
    assert "disturbance d<sub>i</sub>" not in plant
    with ZipFile(FMUS / "TrackingController.fmu") as archive:
        law = archive.read("documentation/index.html").decode()
    assert "data-with" not in plant + law
    assert "<code>epsilon_r</code>" in law
    assert "<code>rho_hat</code>" not in law


def _units(file: Path, place: int = 1) -> dict[str, str]:
    fmu = read_buildable(file).fmus[place]
    return {v.name: v.unit for v in interface_of(fmu.model, fmu.profiles).variables}


def test_units_of_gains_follow_from_those_of_theta_and_x(tmp_path):
    file = tmp_path / "tanks.toml"
    file.write_text(
        'form = "strict-feedback"\n[structure]\nn = 2\np = 2\n'
        'phibar = {"1,1" = [-1, 0], "2,2" = [0, -0.0166]}\n'
        '[units]\nx = ["cm", "cm/s"]\ntheta = ["1/s", "1/s"]\n'
    )
    units = _units(file)
    for name in ("delta", "theta_bound", "theta_center[2]", "theta_half_width[1]", "c[1]"):
        assert units[name] == "1/s", name
    assert [units["theta_hat0[1]"], units["z[1]"], units["z[2]"]] == ["1/s", "cm", "cm/s"]
    assert units["Gamma[1,1]"] == ""  # z_1 and z_2, which it weighs, are measured differently
    assert not any("measure the same" in line for line in spec_warnings(read_spec(file)))
    file.write_text(file.read_text().replace('"1/s"]', '"1/min"]'))
    units = _units(file)
    assert [units["delta"], units["theta_bound"], units["theta_hat0[2]"]] == ["", "", "1/min"]
    assert spec_warnings(read_spec(file))[-1] == (
        "units.theta: '1/s' and '1/min' measure the same, and delta is the radius over the "
        "numbers of all; give one of them"
    )


def test_the_radius_of_an_observer_is_that_of_a(tmp_path):
    file = tmp_path / "observer.toml"
    file.write_text(
        'form = "observer"\n[structure]\nn = 1\nm = 0\nfilter = "iss"\n[units]\ny = "m"\nu = "m"\n'
    )
    assert _units(file)["z[1]"] == "m"
    file.write_text(file.read_text() + 'theta = ["1/s", "1/s"]\n')
    assert _units(file)["delta"] == "1/s"
    assert _units(ROOT / "specs" / "scalar.toml")["delta"] == "1/s"


def test_of_a_missing_file_a_spec_is_asked_for(tmp_path):
    with pytest.raises(InvalidInput, match=r"no such file; give the path of a spec \(\.toml\)"):
        read_buildable(tmp_path / "no.toml")


@pytest.mark.parametrize("value", ['{value = 30, unit = "1/h"}', "{value = 1}"])
def test_a_number_with_a_unit_is_told_that_a_spec_takes_its_own(tmp_path, value):
    file = tmp_path / "own.toml"
    file.write_text(f'form = "scalar"\n[controller]\nstart = {{delta = {value}}}\n')
    with pytest.raises(InvalidInput) as told:
        read_spec(file)
    assert str(told.value).startswith(f"{file}: controller.start.delta = {{value = ")
    assert str(told.value).endswith(
        "is not valid; give numbers alone: a spec takes them in the units of its table [units], "
        "and times in seconds"
    )
