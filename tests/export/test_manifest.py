"""What the folder of FMUs says of their specs, as `congelation run` and `build` see it."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from congelation.cli import main
from congelation.scenario.load import load_scenario
from tests.scenarios import ROOT

SCENARIO = """
title = "A loop"
connections = ["plant.x -> controller.x", "controller.u -> plant.u"]
components.plant.fmu = "ScalarPlant"
components.controller.fmu = "ScalarController"
experiment = {stop_time = 1.0, step = 0.1}
"""


def test_fmus_older_than_their_spec_are_named_with_the_command_that_builds_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    spec, scenario = Path("a plant.toml"), Path("scenario.toml")
    text = (ROOT / "specs" / "scalar.toml").read_text("utf-8")
    spec.write_text(text, "utf-8")
    scenario.write_text(SCENARIO, "utf-8")
    with pytest.raises(SystemExit) as ended:
        main(["build", str(spec)])
    assert ended.value.code == 0
    spec.write_text(f"# A comment changes no FMU.\n{text}", "utf-8")
    assert load_scenario(scenario).warnings == ()

    spec.write_text(text.replace("gamma = 1", "gamma = 2"), "utf-8")
    found = load_scenario(scenario).warnings
    command = "congelation build 'a plant.toml'"
    assert found == tuple(
        f"scenario.toml: fmus/Scalar{part}.fmu was built from another 'a plant.toml'; run "
        f"`{command}`"
        for part in ("Plant", "Controller")
    )
    with pytest.raises(SystemExit) as ended:
        main(shlex.split(command)[1:])
    assert ended.value.code == 0
    assert load_scenario(scenario).warnings == ()

    # What cannot be known is no warning.
    spec.unlink()
    assert load_scenario(scenario).warnings == ()
    Path("fmus/manifest.json").write_text("[]", "utf-8")
    assert load_scenario(scenario).warnings == ()
