"""Result directories for other programs: CSV, and MATLAB's MAT-files."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv
from scipy.io import savemat

from congelation.errors import InvalidInput
from congelation.places import replace_whole
from congelation.results.record import Trajectory
from congelation.results.results import Results

__all__ = ["matlab_name", "write_csv", "write_mat"]

LONGEST_NAME = 63
"""Characters of a MATLAB name; later ones are ignored there."""


def write_csv(results: Results, folder: Path) -> tuple[Path, ...]:
    """Write ``runs.csv`` and ``trajectories/<run_id>.csv``, with the columns of the Parquet files.

    Parameters
    ----------
    results : Results
    folder : Path
        Made if it does not exist; files of the same names are replaced.

    Raises
    ------
    InvalidInput
        If the directory holds no finished run.
    StoreError
        If a file cannot be written.
    """
    rows = _rows(results)
    files = [folder / "runs.csv"]
    _write_table(pa.Table.from_pylist(list(rows)), files[0])
    for run_id, trajectory in _trajectories(results, rows):
        file = folder / "trajectories" / f"{run_id}.csv"
        data = {"time": trajectory.time}
        data |= dict(zip(trajectory.columns, trajectory.values.T, strict=True))
        _write_table(pa.table(data), file)
        files.append(file)
    return tuple(files)


def write_mat(results: Results, file: Path) -> None:
    """Write one MAT-file (version 5) with the structures `runs` and `trajectories`.

    ``runs.NAME`` is a column, an array or a cell array of strings, with names as `matlab_name`
    makes them; missing numbers are nan. ``trajectories(k)`` has run_id, time (N, 1), values
    (N, M), columns and units (cells of M strings, the names as everywhere else).

    Raises
    ------
    InvalidInput
        If the directory holds no finished run, or two columns would have the same name.
    StoreError
        If the file cannot be written.
    """
    rows = _rows(results)
    names = {matlab_name(name): name for name in rows[0]}
    if len(names) < len(rows[0]):
        twice = next(n for n in rows[0] if names[matlab_name(n)] != n)
        raise InvalidInput(
            f"column '{twice}' and '{names[matlab_name(twice)]}' would both be "
            f"'{matlab_name(twice)}' in MATLAB; export --csv instead"
        )
    runs = {short: _column([row[name] for row in rows]) for short, name in names.items()}
    content = {"runs": runs, "trajectories": _structures(_trajectories(results, rows))}
    replace_whole(file, lambda temporary: _save(temporary, content))


def matlab_name(name: str) -> str:
    """A column's name as MATLAB can hold it: ``plant.x0[1]`` becomes ``plant_x0_1``.

    Letters lose their accents (``plänt`` becomes ``plant``), other letters and digits beyond ASCII
    become u and their code point, everything else _; a name that does not begin with a letter gets
    an x before it.
    """
    letters = [c for c in unicodedata.normalize("NFKD", name) if not unicodedata.combining(c)]
    spelt = "".join(c if c.isascii() or not c.isalnum() else f"u{ord(c):x}" for c in letters)
    short = re.sub(r"[^A-Za-z0-9_]+", "_", spelt).strip("_")
    return (short if short[:1].isalpha() else f"x{short}")[:LONGEST_NAME]


def _rows(results: Results) -> tuple[dict[str, Any], ...]:
    rows = tuple(results.runs.rows())
    if not rows:
        raise InvalidInput(f"{results.folder} holds no finished run")
    return rows


def _trajectories(
    results: Results, rows: Sequence[Mapping[str, Any]]
) -> Iterable[tuple[str, Trajectory]]:
    """The trajectories that were kept, one at a time."""
    for row in rows:
        if results.store.trajectory_file(row["run_id"]).is_file():
            yield row["run_id"], results.store.trajectory(row["run_id"])


def _write_table(table: pa.Table, file: Path) -> None:
    replace_whole(file, lambda temporary: csv.write_csv(table, temporary))


def _save(file: Path, content: Mapping[str, object]) -> None:
    with file.open("wb") as stream:  # given a name, savemat would append .mat to it
        savemat(stream, dict(content), long_field_names=True, oned_as="column", do_compression=True)


def _column(values: Sequence[object]) -> np.ndarray[Any, np.dtype[Any]]:
    if any(isinstance(value, str) for value in values):
        return _cells("" if value is None else str(value) for value in values)
    return np.array([np.nan if v is None else v for v in values], dtype=float)


def _cells(texts: Iterable[str]) -> np.ndarray[Any, np.dtype[Any]]:
    """A cell array."""
    listed = list(texts)
    cells = np.empty(len(listed), dtype=object)
    cells[:] = listed
    return cells


def _structures(
    trajectories: Iterable[tuple[str, Trajectory]],
) -> np.ndarray[Any, np.dtype[Any]]:
    """A structure array with one element per trajectory."""
    elements = [
        (
            run_id,
            found.time,
            found.values,
            _cells(found.columns),
            _cells(found.units[column] for column in found.columns),
        )
        for run_id, found in trajectories
    ]
    fields = ("run_id", "time", "values", "columns", "units")
    return np.array(elements, dtype=[(name, object) for name in fields])
