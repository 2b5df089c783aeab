"""Result directories made of closed forms, for the tests of the report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from congelation.results.records import Trajectory
from congelation.results.store import Store

ABOUT = {
    "title": "Two <runs>",
    "scenario_file": "loop.toml",
    "scenario": 'title = "Two <runs>"\n',
    "varied": ["controller.damping"],
    "metrics": {
        "peak_x": {"metric": "peak", "of": "plant.x", "definition": "max |v| & more", "unit": "m"},
        "settling_x": {
            "metric": "settling_time",
            "of": "plant.x",
            "definition": "the last time",
            "unit": "s",
        },
    },
    "figures": [
        {
            "name": "loop",
            "panels": ["plant.x", "controller.u", "plant.theta", "|plant.x|"],
            "span": None,
        },
        {"name": "start", "panels": ["plant.x"], "span": [0.0, 1.0]},
    ],
    "fmus": {"plant": {"file": "Plant.fmu", "sha256": "5e1f"}},
    "versions": {"congelation": "0.1.0+abc", "Python": "3.11"},
}

COLUMNS = ("plant.x[1]", "plant.x[2]", "controller.u", "plant.theta[1]")
UNITS = {"plant.x[1]": "m", "plant.x[2]": "m/s2", "plant.theta[1]": "1/s"}


def trajectory(gain: float, rows: int = 5001) -> Trajectory:
    """x decays, u grows with `gain`, theta is the same for every gain."""
    t = np.linspace(0.0, 10.0, 5001)[:rows]
    x = np.exp(-t)[:, np.newaxis] * np.column_stack([np.cos(3 * t), np.sin(3 * t)])
    values = np.column_stack([x * (1.0 + 1e-3 * gain), gain * np.exp(-t), np.sin(7 * t)])
    return Trajectory(t, COLUMNS, values, UNITS)


def row(run_id: str, variant: str, **changes: object) -> Mapping[str, object]:
    return {
        "run_id": run_id,
        "variant": variant,
        "controller.damping": variant == "Controller 1",
        "status": "COMPLETED",
        "message": "The run reached its stop time.",
        "peak_x": 1.23456789,
        "settling_x": float("inf"),
        "macro_steps": 5000,
        "wall_time": 0.5,
        **changes,
    }


def stored(folder: Path, **about: object) -> Store:
    """Two completed runs."""
    store = Store(folder)
    store.create()
    store.write(row("r1", "Controller 1", settling_x=2.5), trajectory(1000.0))
    store.write(row("r2", "Controller 2"), trajectory(1.0))
    store.compact(["r1", "r2"], {**ABOUT, **about})
    return store


def stored_failures(folder: Path) -> Store:
    """One run that ended early, and one that never started."""
    store = Store(folder)
    store.create()
    failed = {"peak_x": None, "settling_x": None, "status": "DIVERGED"}
    store.write(row("r1", "Controller 1", message="plant: <too> large", **failed), trajectory(1, 9))
    store.write(row("r2", "Controller 2", message="no start", **failed), trajectory(1, 0))
    store.compact(["r1", "r2"], ABOUT)
    return store
