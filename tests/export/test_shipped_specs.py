"""Every spec that is shipped builds, validates, and its loop settles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from congelation.cosim import Component, Connection, Status, System, simulate
from congelation.export.build import build
from congelation.export.spec import BlockSpec, Spec, read_buildable

SPECS = sorted((Path(__file__).resolve().parents[2] / "specs").glob("*.toml"))
BLOCKS = [file for file in SPECS if isinstance(read_buildable(file), BlockSpec)]


@pytest.mark.slow
@pytest.mark.parametrize("file", [f for f in SPECS if f not in BLOCKS], ids=lambda file: file.stem)
def test_closed_loop(file, tmp_path):
    spec = read_buildable(file)
    assert isinstance(spec, Spec)
    build(spec, out=tmp_path)
    measured = spec.controller.model.inputs[0].variables.name
    plant = Component("plant", tmp_path / f"{spec.plant.name}.fmu", {})
    controller = Component("controller", tmp_path / f"{spec.controller.name}.fmu", {})
    links = [Connection(f"plant.{measured}", f"controller.{measured}")]
    system = System([plant, controller], [*links, Connection("controller.u", "plant.u")])
    result = simulate(system, stop_time=8.0, step=1e-3, tolerance=1e-6, coupling="hermite")
    assert result.status is Status.COMPLETED, result.message
    size = np.max(np.abs(result.values[:, columns(result, "plant.x")]), axis=1)
    assert size[-1] < 0.1 * size[0]


def columns(result, name):
    return [k for k, column in enumerate(result.names) if column.split("[")[0] == name]
