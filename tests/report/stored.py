"""Result directories made of closed forms, for the tests of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from congelation.results.record import RunRecord, Trajectory
from congelation.results.results import Results
from congelation.results.store import Store
from congelation.results.trajectory_file import trajectory_bytes

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
    "swept": False,
}

COLUMNS = ("plant.x[1]", "plant.x[2]", "controller.u", "plant.theta[1]")
UNITS = {"plant.x[1]": "m", "plant.x[2]": "m/s2", "plant.theta[1]": "1/s"}


def trajectory(gain: float, rows: int = 5001) -> Trajectory:
    """x decays, u grows with `gain`, theta is the same for every gain."""
    t = np.linspace(0.0, 10.0, 5001)[:rows]
    x = np.exp(-t)[:, np.newaxis] * np.column_stack([np.cos(3 * t), np.sin(3 * t)])
    values = np.column_stack([x * (1.0 + 1e-3 * gain), gain * np.exp(-t), np.sin(7 * t)])
    return Trajectory(t, COLUMNS, values, UNITS)


def record(run_id: str, number: int, **changes: object) -> RunRecord:
    values: dict[str, object] = {
        "study": "s",
        "number": number,
        "variant": f"Controller {number}",
        "settings": {"controller.damping": number == 1},
        "status": "COMPLETED",
        "message": "The run reached its stop time.",
        "metrics": {"peak_x": 1.23456789, "settling_x": float("inf")},
        "steps": 5000,
        "wall_time": 0.5,
    }
    return RunRecord(run_id=run_id, **{**values, **changes})  # type: ignore[arg-type]


def results(
    folder: Path,
    entries: Sequence[tuple[RunRecord, Trajectory]],
    more: Sequence[RunRecord] = (),
    **about: object,
) -> Results:
    """A result directory with these runs, and `more` without trajectories."""
    store = Store(folder)
    store.create()
    store.begin("s", {**ABOUT, **about})
    for entry, recorded in entries:
        store.write_trajectory(entry.run_id, trajectory_bytes(recorded))
    store.add([*(entry for entry, _ in entries), *more])
    store.close()
    return Results(folder)


def stored(folder: Path, deviations: Mapping[str, float] | None = None) -> Results:
    """Two completed runs."""
    first = {"metrics": {"peak_x": 1.23456789, "settling_x": 2.5}, "deviations": deviations or {}}
    return results(
        folder,
        [
            (record("r1", 1, **first), trajectory(1000.0)),
            (record("r2", 2), trajectory(1.0)),
        ],
    )


def stored_failures(folder: Path) -> Results:
    """One run that ended early, and one that never started."""
    failed = {"metrics": {"peak_x": None, "settling_x": None}, "status": "DIVERGED"}
    return results(
        folder,
        [
            (record("r1", 1, message="plant: <too> large", **failed), trajectory(1, 9)),
            (record("r2", 2, message="no start", **failed), trajectory(1, 0)),
        ],
    )


def stored_study(folder: Path, kept: int = 3) -> Results:
    """Two variants on a grid of omega and a: the second settles below omega = 10 alone."""
    entries = []
    for number, (omega, a) in enumerate((w, a) for w in (0.1, 1.0, 10.0, 100.0) for a in (1, 2)):
        for variant in (1, 2):
            settles = variant == 1 or omega < 10.0
            entries.append(
                record(
                    f"r{number}{variant}",
                    2 * number + variant,
                    variant=f"Controller {variant}",
                    settings={"plant.omega": omega, "plant.a": float(a)},
                    metrics={
                        "peak_x": a * (1.0 + omega / 100.0),
                        "settling_x": variant * a if settles else float("inf"),
                        "peak_u": 50.0 * a if variant == 1 else float(a),
                    },
                )
            )
    failed = {"metrics": {}, "status": "DIVERGED", "message": "plant: x[1] <too> large"}
    entries[-1] = replace(entries[-1], **failed)  # type: ignore[arg-type]
    metrics = {**ABOUT["metrics"]}  # type: ignore[dict-item]
    metrics["peak_u"] = {"metric": "peak", "of": "controller.u", "definition": "max", "unit": ""}
    about = {"swept": True, "varied": ["plant.omega", "plant.a"], "metrics": metrics}
    held = [(entry, trajectory(1.0)) for entry in entries[:kept]]
    return results(folder, held, entries[kept:], **about)
