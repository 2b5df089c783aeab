"""Specs: what is read, and what a mistake is told."""

import re
from pathlib import Path

import pytest

import build_fmu
from congelation.errors import InvalidInput
from congelation.export.spec import read_spec

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
        ('"2,2" = [0.5]', '"2,2" = [0.5, 1]', "structure.phibar.2,2 .* 1 numbers"),
        ("c = [1, 2]", "c = [1]", "c = .1. is not valid; give 2 numbers"),
        ("c = [1, 2]", "d = [1, 2]", "d is not known"),
        ('name = "C"', 'name = "my C"', "controller.name = 'my C' is not valid"),
        ('"theta[1]"', '"theta[2]"', "plant.profile.theta.2. is not known"),
        ("{constant = 1}", "{constnat = 1}", "constnat"),
        ("[structure]", "[structur]", "structur is not known"),
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
    assert build_fmu.main(["--spec", str(file), "--out", str(tmp_path)]) == 2
    assert "the smallest feasible r is 10.0499" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.fmu"))


def test_command(tmp_path, capsys):
    assert build_fmu.main(["--spec", str(tmp_path / "none.toml")]) == 2
    assert "no such file" in capsys.readouterr().err
