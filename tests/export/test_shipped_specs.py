"""Every spec that is shipped builds, by `make fmus` or here, and its loop settles."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from congelation.cosim import Component, Connection, Status, System, simulate
from congelation.export.build import build
from congelation.export.spec import Spec, read_buildable
from tests.scenarios import FMUS, ROOT

SPECS = [
    file
    for file in sorted((ROOT / "specs").glob("*.toml"))
    if "plant" in tomllib.loads(file.read_text("utf-8"))  # no block
]


@pytest.mark.slow
@pytest.mark.parametrize("file", SPECS, ids=lambda file: file.stem)
def test_closed_loop(file, tmp_path):
    spec = read_buildable(file)
    assert isinstance(spec, Spec)
    folder = FMUS
    if not (FMUS / f"{spec.plant.name}.fmu").is_file():  # an example that no scenario uses
        build(spec, out=(folder := tmp_path))
    measured = spec.controller.model.inputs[0].variables.name
    plant = Component("plant", folder / f"{spec.plant.name}.fmu", {})
    controller = Component("controller", folder / f"{spec.controller.name}.fmu", {})
    links = [Connection(f"plant.{measured}", f"controller.{measured}")]
    system = System([plant, controller], [*links, Connection("controller.u", "plant.u")])
    result = simulate(system, stop_time=8.0, step=1e-3, tolerance=1e-6, coupling="hermite")
    assert result.status is Status.COMPLETED, result.message
    size = np.max(np.abs(result.values[:, columns(result, "plant.x")]), axis=1)
    assert size[-1] < 0.1 * size[0]


def columns(result, name):
    return [k for k, column in enumerate(result.names) if column.split("[")[0] == name]
