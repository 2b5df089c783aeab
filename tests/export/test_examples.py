"""What one starts from: copies of the shipped examples, and a new spec and scenario."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from congelation.errors import InvalidInput
from congelation.export.build import build
from congelation.export.examples import copy_examples, write_starter
from congelation.places import name_of
from congelation.scenario.load import load_scenario
from congelation.sweep.engine import result_folder
from congelation.verify.certify import certify_design, designs_of
from tests.scenarios import ROOT


def test_examples_are_those_of_the_checkout(tmp_path):
    files = copy_examples(tmp_path)
    for kind in ("specs", "scenarios"):
        for source in (path for path in (ROOT / kind).iterdir() if path.is_file()):
            assert (tmp_path / kind / source.name) in files
            assert (tmp_path / kind / source.name).read_bytes() == source.read_bytes()
    assert copy_examples(tmp_path) == files


def test_examples_overwrite_nothing(tmp_path):
    (tmp_path / "specs").mkdir()
    mine = tmp_path / "specs" / "scalar.toml"
    mine.write_text("mine")
    with pytest.raises(InvalidInput, match=r"scalar\.toml is there already"):
        copy_examples(tmp_path)
    assert mine.read_text() == "mine"
    assert not (tmp_path / "scenarios").exists()


def test_a_starter_builds_holds_and_loads(tmp_path):
    folder = write_starter("wing_flap", tmp_path)
    paths = build(folder / "spec.toml", out=folder / "fmus")
    assert [path.name for path in paths] == ["WingFlapPlant.fmu", "WingFlapController.fmu"]
    (design,) = designs_of(folder / "spec.toml")
    assert certify_design(design, samples=50).holds
    scenario = load_scenario(folder / "scenario.toml")
    assert scenario.title == "wing_flap"
    assert scenario.sweep is not None
    # For a spec of another order the scenario needs no change, for states of several units neither.
    text = (folder / "scenario.toml").read_text("utf-8")
    assert tomllib.loads(text)["components"]["plant"] == {"fmu": "WingFlapPlant"}
    assert not scenario.warnings


@pytest.mark.parametrize("source", [None, {"numerator": [2.0], "denominator": [1.0, 1.0]}])
def test_the_commands_of_a_starter_do_not_collide(tmp_path, source):
    """Results of several projects and of run and sweep have folders of their own."""
    folders = []
    for name in ("flap", "servo"):
        file = write_starter(name, tmp_path, source) / "scenario.toml"
        folders.append(name_of(file))
        lines = file.read_text("utf-8").splitlines()
        (swept,) = [line.split() for line in lines if line.startswith("#     congelation sweep")]
        assert swept[3:6] == [str(file), "--out", f"results/{name}_sweep"]
        assert any(line.startswith(f"#     congelation run {file} ") for line in lines)
        assert f"# The first writes into the folder results/{name}." in lines
    assert folders == ["flap", "servo"]
    assert name_of(tmp_path / "flap" / "spec.toml") == "flap"
    assert name_of(tmp_path / "flap" / "fast.toml") == "fast"


def test_results_of_a_scenario_toml_are_called_as_its_folder(tmp_path):
    folder = write_starter("flap", tmp_path)
    build(folder / "spec.toml", out=folder / "fmus")
    scenario = load_scenario(folder / "scenario.toml")
    assert result_folder(scenario, None) == Path("results") / "flap"


@pytest.mark.parametrize("name", ["2nd", "a-b", "", "a/b", "ä"])
def test_names_that_are_refused(tmp_path, name):
    with pytest.raises(InvalidInput, match="is not valid"):
        write_starter(name, tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_starter_overwrites_nothing(tmp_path):
    (tmp_path / "mine").mkdir()
    with pytest.raises(InvalidInput, match="is there already"):
        write_starter("mine", tmp_path)
