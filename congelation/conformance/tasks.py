"""What a rule has done in another process, through `Bench.elsewhere`."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping

from congelation.conformance.bench import Bench
from congelation.conformance.description import Value
from congelation.conformance.trajectory import Trajectory, demand

__all__ = ["TASKS", "from_text", "to_text"]


def to_text(trajectory: Trajectory) -> str:
    """A trajectory as JSON that keeps every bit (floats in hexadecimal)."""

    def cell(value: Value) -> object:
        return {"hex": value.hex()} if isinstance(value, float) else value

    rows = [[cell(value) for value in row] for row in trajectory.rows]
    return json.dumps({"names": trajectory.names, "rows": rows})


def from_text(text: str) -> Trajectory:
    """The inverse of `to_text`."""

    def value(cell: object) -> Value:
        if isinstance(cell, dict):
            return float.fromhex(cell["hex"])
        return cell  # type: ignore[return-value]  # JSON gives back what to_text put in

    data = json.loads(text)
    rows = tuple(tuple(value(cell) for cell in row) for row in data["rows"])
    return Trajectory(tuple(data["names"]), rows)


def _alone(bench: Bench) -> str:
    """Run the FMU with nothing else in the process."""
    return to_text(bench.alone())


def _replay(bench: Bench) -> str:
    """Continue from a serialized state; the argument is "point:hexadecimal bytes"."""
    point, data = bench.job.argument.split(":")
    instance = bench.fresh()
    status, state = instance.deserialize(bytes.fromhex(data))
    demand(status, "fmi2DeSerializeFMUstate in another process")
    demand(instance.set_state(state), "fmi2SetFMUstate in another process")
    return to_text(bench.run(instance, first=int(point)))


TASKS: Mapping[str, Callable[[Bench], str]] = {"alone": _alone, "replay": _replay}
