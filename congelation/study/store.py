"""The result directory: one trajectory file and one row per run, each written once, whole.

    DIR/trajectories/<run_id>.parquet   column ``time`` and one column per recorded variable
    DIR/parts/<run_id>.parquet          the row of a finished run, written after its trajectory
    DIR/runs.parquet                    all rows, compacted from the parts

Files appear by renaming a complete temporary file in the same directory, so a reader never sees
half of one, and a run is finished exactly if its row exists.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

import congelation
from congelation.errors import CongelationError, InvalidInput, nearest

__all__ = [
    "Store",
    "StoreError",
    "Study",
    "Trajectory",
    "code_version",
    "content_hash",
    "file_hash",
    "metrics_of",
    "replace_whole",
    "settings_of",
]


class StoreError(CongelationError):
    """A result that cannot be written; the text names the file and the reason."""


Row = Mapping[str, object]

_METADATA = b"congelation"
_BATCH = 256
"""Rows joined at a time: one alone takes 16 kB, one of many 200 bytes."""
_MANY_ROWS = {"compression": "zstd"}
_ONE_ROW = {"compression": "none", "use_dictionary": False, "write_statistics": False}
"""Of one row each would take time, and make it no smaller."""
_ID_LENGTH = 16  # hex digits; 64 bits, so 10^6 runs collide with probability 3e-8


def content_hash(content: object) -> str:
    """Identifier of JSON-representable `content`: equal content, equal identifier."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=True)
    return hashlib.sha256(text.encode()).hexdigest()[:_ID_LENGTH]


def file_hash(file: Path) -> str:
    """SHA-256 of a file, in hex."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@cache
def code_version() -> str:
    """Version of congelation and a digest of its sources: ``0.1.0+5f0c9a1d2b3e``."""
    root = Path(congelation.__file__).parent
    digest = hashlib.sha256()
    for source in sorted(root.rglob("*.py")):
        digest.update(source.relative_to(root).as_posix().encode() + b"\0")
        digest.update(source.read_bytes() + b"\0")
    try:
        number = version("congelation")
    except PackageNotFoundError:  # used from a source tree that is not installed
        number = "0"
    return f"{number}+{digest.hexdigest()[:12]}"


def settings_of(row: Row) -> dict[str, object]:
    """The varied settings of a row: its columns between `variant` and `status`."""
    return _between(row, "variant", "status")


def metrics_of(row: Row) -> dict[str, object]:
    """The metrics of a row: its columns between `message` and `macro_steps`."""
    return _between(row, "message", "macro_steps")


def _between(row: Row, first: str, last: str) -> dict[str, object]:
    names = list(row)
    return {name: row[name] for name in names[names.index(first) + 1 : names.index(last)]}


@dataclass(frozen=True)
class Trajectory:
    """A recorded run: row k of `values` belongs to ``time[k]``.

    Parameters
    ----------
    time : numpy.ndarray
        Shape (N,), in seconds.
    columns : tuple of str
        M names ``component.variable``.
    values : numpy.ndarray
        Shape (N, M).
    units : mapping
        Unit of each column; a missing or empty one is dimensionless.
    """

    time: npt.NDArray[np.float64]
    columns: tuple[str, ...]
    values: npt.NDArray[np.float64]
    units: Mapping[str, str]

    def group(self, name: str) -> tuple[str, ...]:
        """Columns called `name` or ``name[..]``, in order; ``plant.x`` is all of the vector x."""
        return tuple(c for c in self.columns if c == name or c.startswith(f"{name}["))

    def select(self, columns: Sequence[str]) -> npt.NDArray[np.float64]:
        """The values of some columns, shape (N, len(columns))."""
        return self.values[:, [self.columns.index(c) for c in columns]]


@dataclass(frozen=True)
class Study:
    """What a result directory holds: its rows, and the study they belong to.

    Parameters
    ----------
    rows : tuple of mapping
        One per run; every row has every column, None where it does not apply.
    about : mapping
        Title, scenario text, figures, metric definitions and versions, as they were stored.
    """

    rows: tuple[dict[str, Any], ...]
    about: Mapping[str, Any]


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

    def write(self, row: Row, trajectory: Trajectory | None = None) -> None:
        """Store a finished run: its trajectory first, if it is kept, then its row.

        Raises
        ------
        StoreError
            If a file cannot be written; the run then does not count as finished.
        """
        run_id = str(row["run_id"])
        if trajectory is not None:
            _write_whole(_trajectory_table(trajectory), self.trajectory_file(run_id))
        _write_whole(pa.Table.from_pylist([dict(row)]), self.part_file(run_id), _ONE_ROW)

    def finished(self, known: Container[str] = ()) -> set[str]:
        """The run_ids that have a readable row, those `known` to have one left out."""
        parts = (self.root / "parts").glob("[!.]*.parquet")
        return {part.stem for part in parts if part.stem not in known and _is_readable(part)}

    def is_finished(self, run_id: str) -> bool:
        """Whether a run has a readable row."""
        return _is_readable(self.part_file(run_id))

    def row(self, run_id: str) -> dict[str, Any]:
        """The row of a finished run."""
        rows: list[dict[str, Any]] = _read(self.part_file(run_id), "no such run").to_pylist()
        return rows[0]

    def rows(self) -> tuple[dict[str, Any], ...]:
        """The rows of all runs finished so far, also while a sweep is under way.

        Those of runs.parquet come first, in its order. Every row has every column.

        Raises
        ------
        InvalidInput
            If this is no result directory.
        """
        if not (self.root / "parts").is_dir() and not self.index.is_file():
            raise InvalidInput(f"{self.root} is no result directory")
        rows = list(self.read().rows) if self.index.is_file() else []
        new = self.finished({row["run_id"] for row in rows})
        rows += [self.row(run_id) for run_id in sorted(new)]
        names = dict.fromkeys(name for row in rows for name in row)
        return tuple({name: row.get(name) for name in names} for row in rows)

    def find(self, run_id: str) -> dict[str, Any]:
        """The row of the finished run whose run_id begins with `run_id`.

        Raises
        ------
        InvalidInput
            If there is no such run, or more than one.
        """
        known = sorted(self.finished())
        found = [name for name in known if name.startswith(run_id)]
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
    return pa.concat_tables(list(tables), promote_options="permissive").combine_chunks()


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
