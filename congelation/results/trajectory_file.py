"""A trajectory as a Parquet file: column ``time``, then one per recorded variable, with units."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from congelation.errors import InvalidInput
from congelation.results.record import Steps, Trajectory

STEPS = b"steps"
"""Key of the file's metadata with the steps of the master."""


def trajectory_bytes(trajectory: Trajectory) -> bytes:
    """The Parquet file of a trajectory."""
    units = {"time": "s", **trajectory.units}
    names = ("time", *trajectory.columns)
    fields = [pa.field(n, pa.float64(), metadata={"unit": units.get(n, "")}) for n in names]
    arrays = [pa.array(values) for values in (trajectory.time, *trajectory.values.T)]
    stream = io.BytesIO()
    about = None if trajectory.steps is None else {STEPS: trajectory.steps.to_json()}
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields, about))
    pq.write_table(table, stream, compression="zstd")
    return stream.getvalue()


def read_trajectory(file: Path) -> Trajectory:
    """What `trajectory_bytes` was given.

    Raises
    ------
    FileNotFoundError
    InvalidInput
        If the file is damaged.
    """
    try:
        table = pq.ParquetFile(file).read()
    except FileNotFoundError:
        raise
    except (OSError, pa.ArrowInvalid) as error:
        raise InvalidInput(f"{file} is damaged: {str(error).splitlines()[0]}") from error
    columns = tuple(name for name in table.column_names if name != "time")
    values = [table[name].to_numpy() for name in columns]
    units = {
        name: (table.schema.field(name).metadata or {}).get(b"unit", b"").decode()
        for name in columns
    }
    time = table["time"].to_numpy()
    rows = np.array(values).T.reshape(len(time), len(columns))
    steps = (table.schema.metadata or {}).get(STEPS)
    found = None if steps is None else Steps.of_json(steps)
    return Trajectory(time, columns, rows, units, found)
