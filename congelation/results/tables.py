"""The tables of runs.sqlite: one column per setting, metric and other entry of the records.

A column is added by the first record that has it, so that studies with other axes share a folder.
"""

from __future__ import annotations

import itertools
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any

import pyarrow as pa

from congelation.results.record import COLUMNS, GROUPS, RunRecord

ROWS_AT_ONCE = 10_000
"""Rows read at a time, which bounds the memory that an export takes."""

TABLES = {"runs", "studies", "plans"}

KEYS = {"run_id", "study", "number", "variant", "status"}
"""The columns of runs without which nothing can be said of one."""

_TYPES = {"bool": "BOOLEAN", "int": "INTEGER", "float": "REAL", "str": "TEXT"}
"""The types of columns, by those of Python."""

_ORDER = "FROM runs LEFT JOIN studies USING (study) {where} ORDER BY used, study, number, run_id"


def make_tables(connection: sqlite3.Connection) -> None:
    """Make the tables that are not there yet: runs, studies, plans."""
    declared = {f.name: str(f.type).partition(" ")[0] for f in fields(RunRecord)}
    kinds = {column: _TYPES[declared[n]] for n, column in COLUMNS.items() if n not in GROUPS}
    kinds["run_id"] += " PRIMARY KEY"
    columns = ", ".join(f"{_quoted(column)} {kind}" for column, kind in kinds.items())
    connection.execute(f"CREATE TABLE IF NOT EXISTS runs ({columns})")
    connection.execute(
        "CREATE TABLE IF NOT EXISTS studies (study TEXT PRIMARY KEY, about TEXT, used REAL)"
    )
    connection.execute(
        "CREATE TABLE IF NOT EXISTS plans (plan TEXT PRIMARY KEY, keys BLOB, numbers BLOB)"
    )


def insert(connection: sqlite3.Connection, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows, in place of earlier ones of the same runs, with the columns that they need.

    A new column has the type of its first value, and none where there is no value.
    """
    new: dict[str, str] = {}
    known = {name for name, _ in columns_of(connection)}
    for row in rows:
        for name in row.keys() - known:
            kind = "REAL" if name.startswith(GROUPS["metrics"]) else ""
            new[name] = _TYPES.get(type(row[name]).__name__) or new.get(name, kind)
    for name in dict.fromkeys(name for row in rows for name in row if name in new):
        connection.execute(f"ALTER TABLE runs ADD COLUMN {_quoted(name)} {new[name]}")
    for names, group in itertools.groupby(rows, tuple):
        columns, marks = ", ".join(map(_quoted, names)), ", ".join("?" * len(names))
        connection.executemany(
            f"INSERT OR REPLACE INTO runs ({columns}) VALUES ({marks})",
            [[row[name] for name in names] for row in group],
        )


def columns_of(connection: sqlite3.Connection) -> list[tuple[str, str]]:
    """Name and type of every column: those of all runs first, the groups in their places.

    A column that is none of `COLUMNS` is that of a later version, and left out.
    """
    order = {column: place for place, column in enumerate(COLUMNS.values())}
    found = []
    for row in connection.execute("PRAGMA table_info(runs)"):
        name, kind = row[1], row[2]
        prefix = next((p for p in GROUPS.values() if name.startswith(p)), name)
        if prefix in order:
            found.append((order[prefix], name, kind))
    found.sort(key=lambda entry: entry[0])
    return [(name, kind) for _, name, kind in found]


def batches(
    connection: sqlite3.Connection, names: Mapping[str, str], study: str | None = None
) -> Iterator[list[dict[str, Any]]]:
    """Finished runs by column, some at a time, in order of the plans."""
    where, parameters = restriction(study)
    columns = ", ".join(f"runs.{_quoted(name)}" for name in names)
    order = _ORDER.format(where=where)
    cursor = connection.execute(f"SELECT {columns} {order}", parameters)
    flags = [name for name, kind in names.items() if kind == "BOOLEAN"]
    while rows := cursor.fetchmany(ROWS_AT_ONCE):
        found = [dict(zip(names, row, strict=True)) for row in rows]
        for row in found:
            for name in flags:  # SQLite returns them as integers
                if row[name] in (0, 1):
                    row[name] = bool(row[name])
        yield found


def restriction(study: str | None) -> tuple[str, tuple[str, ...]]:
    """The restriction of a query to a study, with its parameters."""
    return ("", ()) if study is None else ("WHERE study = ?", (study,))


def arrow_type(connection: sqlite3.Connection, name: str, kind: str) -> pa.DataType:
    """The type of a column in Parquet: that of its values where they are not all as declared."""
    found = connection.execute(f"SELECT DISTINCT typeof({_quoted(name)}) FROM runs").fetchall()
    held = {row[0] for row in found} - {"null"}
    if "TEXT" in kind or "text" in held:
        return pa.string()
    if kind == "REAL" or "real" in held:
        return pa.float64()
    return pa.bool_() if kind == "BOOLEAN" else pa.int64()


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'
