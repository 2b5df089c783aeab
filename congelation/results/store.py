"""The result directory: one trajectory file and one row per run, each written once, whole.

    DIR/trajectories/<run_id>.parquet   column ``time`` and one column per recorded variable
    DIR/parts/<run_id>.parquet          the row of a finished run, written after its trajectory
    DIR/runs.parquet                    all rows, compacted from the parts

Files appear by renaming a complete temporary file in the same directory, so a reader never sees
half of one, and a run is finished exactly if its row exists.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from congelation.errors import CongelationError, InvalidInput, nearest
from congelation.results.records import Row, Study, Trajectory

__all__ = ["Store", "StoreError", "replace_whole"]


class StoreError(CongelationError):
    """A result that cannot be written; the text names the file and the reason."""


_METADATA = b"congelation"
_BATCH = 256
"""Rows joined at a time: one alone takes 16 kB, one of many 200 bytes."""
_MANY_ROWS = {"compression": "zstd"}
_ONE_ROW = {"compression": "none", "use_dictionary": False, "write_statistics": False}
"""Of one row each would take time, and make it no smaller."""


@dataclass(frozen=True)
class Store:
    """A result directory."""

    root: Path

    @property
    def index(self) -> Path:
        """The file with all rows."""
        return self.root / "runs.parquet"

    def trajectory_file(self, run_id: str) -> Path:
        """Where the trajectory of a run is kept."""
        return self.root / "trajectories" / f"{run_id}.parquet"

    def part_file(self, run_id: str) -> Path:
        """Where the row of a run is kept, as whoever ran it wrote it."""
        return self.root / "parts" / f"{run_id}.parquet"

    def create(self) -> None:
        """Make the directory, so that a bad place is told before the first run, not after it."""
        try:
            for folder in (self.root / "trajectories", self.root / "parts"):
                folder.mkdir(parents=True, exist_ok=True)
            if not os.access(self.root, os.W_OK):
                raise PermissionError(13, "Permission denied")
        except OSError as error:
            raise InvalidInput(
                f"results cannot be written to {self.root}: {error.strerror}"
            ) from error

    def write(self, row: Row, trajectory: Trajectory | bytes | None = None) -> None:
        """Store a finished run: its trajectory first, if it is kept, then its row.

        They replace those of an earlier attempt. A trajectory may be the bytes of its file.

        Raises
        ------
        StoreError
            If a file cannot be written; the run then does not count as finished.
        """
        run_id = str(row["run_id"])
        if isinstance(trajectory, bytes):
            content = trajectory
            replace_whole(self.trajectory_file(run_id), lambda file: file.write_bytes(content))
        elif trajectory is not None:
            _write_whole(_trajectory_table(trajectory), self.trajectory_file(run_id))
        _write_whole(pa.Table.from_pylist([dict(row)]), self.part_file(run_id), _ONE_ROW)
        if trajectory is None:
            _discard(self.trajectory_file(run_id))

    def finished(self, known: Container[str] = ()) -> set[str]:
        """The run_ids that have a readable row, those `known` to have one left out."""
        parts = (self.root / "parts").glob("[!.]*.parquet")
        return {part.stem for part in parts if part.stem not in known and _is_readable(part)}

    def written(self, run_id: str) -> int | None:
        """When the row of a run was written, in nanoseconds; None without a readable row."""
        part = self.part_file(run_id)
        return part.stat().st_mtime_ns if _is_readable(part) else None

    def row(self, run_id: str) -> dict[str, Any]:
        """The row of a finished run."""
        rows: list[dict[str, Any]] = _read(self.part_file(run_id), "no such run").to_pylist()
        return rows[0]

    def rows(self) -> tuple[dict[str, Any], ...]:
        """The rows of all runs finished so far, also while a sweep is under way.

        Those of runs.parquet come first, in its order; those that it leaves out as runs of another
        plan are no part of it. Every row has every column.

        Raises
        ------
        InvalidInput
            If this is no result directory.
        """
        self._require()
        study = self.read() if self.index.is_file() else Study((), {})
        rows = list(study.rows)
        unlisted = study.about.get("sweep", {}).get("unlisted", ())
        new = self.finished({*(row["run_id"] for row in rows), *unlisted})
        rows += [self.row(run_id) for run_id in sorted(new)]
        names = dict.fromkeys(name for row in rows for name in row)
        return tuple({name: row.get(name) for name in names} for row in rows)

    def _require(self) -> None:
        """Raise InvalidInput if this is no result directory."""
        if not (self.root / "parts").is_dir() and not self.index.is_file():
            raise InvalidInput(f"{self.root} is no result directory")

    def find(self, run_id: str) -> dict[str, Any]:
        """The row of the finished run whose run_id begins with `run_id`.

        Raises
        ------
        InvalidInput
            If this is no result directory, or there is no such run, or more than one.
        """
        self._require()
        known = sorted(self.finished())
        found = [name for name in known if name.startswith(run_id)]
        if not known:
            raise InvalidInput(f"{self.root} has no runs")
        if not found:
            raise InvalidInput(f"{self.root} has no run '{run_id}'; {nearest(run_id, known)}")
        if len(found) > 1:
            raise InvalidInput(f"{len(found)} runs begin with '{run_id}'; give more of its digits")
        return self.row(found[0])

    def compact(self, run_ids: Sequence[str], about: Mapping[str, object]) -> None:
        """Write runs.parquet: the rows of `run_ids`, in that order."""
        starts = range(0, len(run_ids), _BATCH)
        table = _joined(self._parts(run_ids[start : start + _BATCH]) for start in starts)
        metadata = {_METADATA: json.dumps(dict(about)).encode()}
        _write_whole(table.replace_schema_metadata(metadata), self.index)

    def _parts(self, run_ids: Sequence[str]) -> pa.Table:
        # Not pq.read_table, which makes a data set of each file and takes twice the time.
        return _joined(_read(self.part_file(run_id), "no such run") for run_id in run_ids)

    def replaceable(self) -> set[str]:
        """The run_ids that runs.parquet lists, which a new state of their scenario replaces.

        Raises
        ------
        InvalidInput
            If they are those of a sweep, which may have taken days.
        """
        if not self.index.is_file():
            return set()
        study = self.read()
        if "sweep" in study.about:
            raise InvalidInput(f"{self.root} holds a sweep; give another directory")
        return {str(row["run_id"]) for row in study.rows}

    def remove(self, run_ids: Iterable[str]) -> None:
        """Remove runs."""
        for run_id in run_ids:
            self.part_file(run_id).unlink(missing_ok=True)
            self.trajectory_file(run_id).unlink(missing_ok=True)

    def read(self) -> Study:
        """The rows and the study of this directory.

        Raises
        ------
        InvalidInput
            If it holds no readable runs.parquet.
        """
        table = _read(self.index, f"{self.root} is no result directory")
        about = (table.schema.metadata or {}).get(_METADATA)
        if about is None:
            raise InvalidInput(f"{self.index} was not written by congelation")
        return Study(tuple(table.to_pylist()), json.loads(about))

    def trajectory(self, run_id: str) -> Trajectory:
        """The trajectory of a run.

        Raises
        ------
        InvalidInput
            If there is none, or if its file is damaged.
        """
        table = _read(self.trajectory_file(run_id), f"run {run_id} has no trajectory")
        columns = tuple(name for name in table.column_names if name != "time")
        values = [table[name].to_numpy() for name in columns]
        units = {
            name: (table.schema.field(name).metadata or {}).get(b"unit", b"").decode()
            for name in columns
        }
        time = table["time"].to_numpy()
        return Trajectory(time, columns, np.array(values).T.reshape(len(time), len(columns)), units)


def _joined(tables: Iterable[pa.Table]) -> pa.Table:
    """One table with the columns of all of them, in one piece."""
    several = [pa.table({}), *tables]  # of none at all, it is the empty one
    return pa.concat_tables(several, promote_options="permissive").combine_chunks()


def _trajectory_table(trajectory: Trajectory) -> pa.Table:
    units = {"time": "s", **trajectory.units}
    names = ("time", *trajectory.columns)
    fields = [pa.field(n, pa.float64(), metadata={"unit": units.get(n, "")}) for n in names]
    arrays = [trajectory.time, *trajectory.values.T]
    return pa.Table.from_arrays([pa.array(a) for a in arrays], schema=pa.schema(fields))


def _write_whole(table: pa.Table, file: Path, options: Mapping[str, object] = _MANY_ROWS) -> None:
    """Write a Parquet file that appears complete or not at all."""
    replace_whole(file, lambda temporary: pq.write_table(table, temporary, **options))


def replace_whole(file: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a temporary file beside `file`, then rename it into place.

    Raises
    ------
    StoreError
        If the file cannot be written: no space, no permission.
    """
    temporary = file.with_name(f".{file.name}.{os.getpid()}.tmp")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write(temporary)
        temporary.replace(file)
    except OSError as error:
        raise StoreError(f"{file} cannot be written: {error}") from error
    finally:
        _discard(temporary)


def _is_readable(file: Path) -> bool:
    try:
        pq.read_metadata(file)
    except (OSError, pa.ArrowInvalid):
        return False
    return True


def _discard(file: Path) -> None:
    try:
        file.unlink(missing_ok=True)
    except OSError:  # the error that brought us here says why; this one would only hide it
        return


def _read(file: Path, missing: str) -> pa.Table:
    try:
        return pq.ParquetFile(file).read()
    except FileNotFoundError as error:
        raise InvalidInput(f"{missing}: {file} does not exist") from error
    except (OSError, pa.ArrowInvalid) as error:
        raise InvalidInput(f"{file} is damaged: {str(error).splitlines()[0]}") from error
