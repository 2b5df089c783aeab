"""The result directory: the records of runs in SQLite, their trajectories in Parquet.

    DIR/runs.sqlite                     records, written in batches by the process that plans
    DIR/trajectories/<run_id>.parquet   column ``time`` and one column per recorded variable
    DIR/runs.parquet                    all records, written from runs.sqlite when a study ends

A worker writes a trajectory before its run is reported, so a run is finished exactly if its record
exists. DIR has to be on a file system of the planning machine: SQLite's write-ahead log is not
safe on a network file system.
"""

from __future__ import annotations

import json
import os
import sqlite3
import time
from array import array
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from congelation.cosim.result import Status
from congelation.errors import InvalidInput, nearest
from congelation.places import StoreError, check_folder, replace_whole, write_whole
from congelation.results import tables
from congelation.results.record import RunRecord, Trajectory
from congelation.results.trajectory_file import read_trajectory

METADATA = b"congelation"
"""Key of Parquet metadata with the description of the study."""

ENDED = (Status.COMPLETED.name, Status.TERMINATED.name)
"""How runs end that have a trajectory, if trajectories are kept."""

ANEW = "move it away and run the scenario again"
"""What is to be done about a database that cannot be used."""

DESCRIBED = {"title", "metrics", "varied", "figures", "swept"}
"""What the description of a study has at least."""

BUSY = 60.0
"""Seconds to wait for another process that writes into the same directory."""


@dataclass(frozen=True, eq=False)
class PlannedRuns:
    """The runs of a plan, in the order of their keys: a million are kept and compared in seconds.

    Parameters
    ----------
    keys : array, shape (N,)
        The run_ids as numbers of 64 bits, rising.
    numbers : array, shape (N,)
        The place of each in the plan.
    """

    keys: npt.NDArray[np.uint64]
    numbers: npt.NDArray[np.int64]

    @classmethod
    def of(cls, runs: Iterable[tuple[int, str]]) -> PlannedRuns:
        """The runs with these numbers and run_ids; a run_id that comes again is left out."""
        numbers, keys = array("q"), array("Q")
        for number, run_id in runs:
            numbers.append(number)
            keys.append(int(run_id, 16))
        found, first = np.unique(np.array(keys, np.uint64), return_index=True)
        return cls(found, np.array(numbers, np.int64)[first])

    @classmethod
    def from_bytes(cls, keys: bytes, numbers: bytes) -> PlannedRuns:
        """What `to_bytes` was made of."""
        return cls(np.frombuffer(keys, "<u8"), np.frombuffer(numbers, "<i8"))

    def to_bytes(self) -> tuple[bytes, bytes]:
        """Keys and numbers as bytes, the same on every machine."""
        return self.keys.astype("<u8").tobytes(), self.numbers.astype("<i8").tobytes()

    def __len__(self) -> int:
        return len(self.keys)

    def places(self, run_ids: Collection[str]) -> npt.NDArray[np.intp]:
        """Where these runs stand in the arrays; -1 for one that is not in the plan."""
        wanted = np.array([int(run_id, 16) for run_id in run_ids], np.uint64)
        if not len(self):
            return np.full(len(wanted), -1, np.intp)
        found = np.minimum(np.searchsorted(self.keys, wanted), len(self) - 1)
        return np.where(self.keys[found] == wanted, found, -1)


class Store:
    """A result directory.

    Parameters
    ----------
    root : Path
    """

    def __init__(self, root: Path) -> None:
        self.root = Path(root)
        self.database = self.root / "runs.sqlite"
        self.index = self.root / "runs.parquet"
        self._connection: sqlite3.Connection | None = None
        self._plan: tuple[str, PlannedRuns] | None = None

    def trajectory_file(self, run_id: str) -> Path:
        """Where the trajectory of a run is kept."""
        return self.root / "trajectories" / f"{run_id}.parquet"

    # -- writing ------------------------------------------------------------------------------

    def create(self) -> None:
        """Make the directory, or open it to write into it.

        Raises
        ------
        InvalidInput
            If it cannot be made or written to, or is of an earlier version.
        StoreError
            If runs.sqlite cannot be written.
        """
        self._refuse_old()
        check_folder("results", self.root)
        check_folder("results", self.root / "trajectories")
        with self._errors():
            if not os.path.isfile(self.database):
                self._make_database()
            connection = sqlite3.connect(self.database, timeout=BUSY, isolation_level=None)
            connection.execute("PRAGMA journal_mode=WAL")
            connection.execute("PRAGMA synchronous=FULL")
        self._connection = connection

    def close(self) -> None:
        """Leave a directory that can also be read from a read-only file system."""
        if self._connection is None:
            return
        with suppress(sqlite3.OperationalError):  # another study writes; the last one will do it
            self._connection.execute("PRAGMA journal_mode=DELETE")
        self._connection.close()
        self._connection = None

    def begin(self, study: str, about: Mapping[str, object]) -> None:
        """Let a study be the newest one of this directory, and the runs in its plan be its own."""
        with self._transaction() as connection:
            connection.execute(
                "INSERT OR REPLACE INTO studies VALUES (?, ?, ?)",
                (study, json.dumps(dict(about)), time.time()),
            )
            if self._plan is None:
                return
            plan, known = self._plan
            connection.execute(
                "INSERT OR IGNORE INTO plans VALUES (?, ?, ?)", (plan, *known.to_bytes())
            )
            others = connection.execute("SELECT run_id FROM runs WHERE study != ?", (study,))
            run_ids = [run_id for (run_id,) in others]
            connection.executemany(
                "UPDATE runs SET study = ?, number = ? WHERE run_id = ?",
                (
                    (study, int(known.numbers[place]), run_id)
                    for run_id, place in zip(run_ids, known.places(run_ids).tolist(), strict=True)
                    if place >= 0
                ),
            )

    def add(self, records: Sequence[RunRecord]) -> None:
        """Commit records, in place of earlier ones of the same runs.

        Raises
        ------
        StoreError
            If they cannot be written; none of them is stored then.
        """
        with self._transaction() as connection:
            tables.insert(connection, [record.row() for record in records])

    def write_trajectory(self, run_id: str, content: bytes) -> None:
        """Keep the trajectory of a run; `content` is that of `trajectory_bytes`."""
        write_whole(self.trajectory_file(run_id), content)

    def export(self) -> Path:
        """Write runs.parquet: every record of this directory."""
        with self._reading() as connection:
            names = dict(tables.columns_of(connection))
            schema = pa.schema(
                [(name, tables.arrow_type(connection, name, names[name])) for name in names]
            )
            described = {METADATA: json.dumps(dict(self.about())).encode()}

            def write(file: Path) -> None:
                with pq.ParquetWriter(
                    file, schema.with_metadata(described), compression="zstd"
                ) as writer:
                    for rows in tables.batches(connection, names):
                        writer.write_table(pa.Table.from_pylist(rows, schema=schema))

            replace_whole(self.index, write)
        return self.index

    # -- plans --------------------------------------------------------------------------------

    def plan(
        self,
        plan: str,
        runs: Iterable[tuple[int, str]],
        again: Collection[str] | None = (),
        *,
        trajectories: bool = False,
    ) -> Comparison:
        """Compare a plan with what is finished.

        Parameters
        ----------
        plan : str
            Hash of all that the plan follows from. A plan that `begin` has stored is read back.
        runs : iterable of (int, str)
            Number and run_id of each planned run, in order. It is not used where the plan is
            stored: to compute a million run_ids takes most of a minute.
        again : collection of str, optional
            Runs that ended with such a status are missing; None: all of them are.
        trajectories : bool
            Whether completed runs without a trajectory are missing, too.
        """
        connection = self._connection or self._planner()
        with self._errors():
            stored = connection.execute(
                "SELECT keys, numbers FROM plans WHERE plan = ?", (plan,)
            ).fetchone()
            known = PlannedRuns.from_bytes(*stored) if stored else PlannedRuns.of(runs)
            self._plan = (plan, known)
            missing = np.ones(len(known), bool)
            finished, versions = 0, set()
            rows = connection.execute("SELECT run_id, status, code_version FROM runs")
            total = 0
            while batch := rows.fetchmany(tables.ROWS_AT_ONCE):
                total += len(batch)
                places = known.places([run_id for run_id, _, _ in batch])
                kept = [run_id for run_id, status, _ in batch if trajectories and status in ENDED]
                lost = set(self.without_trajectory(kept)) if kept else set()
                for place, (run_id, status, version) in zip(places.tolist(), batch, strict=True):
                    if place >= 0:
                        finished += 1
                        versions.add(version)
                        missing[place] = again is None or status in again or run_id in lost
        numbers = array("q", np.sort(known.numbers[missing].astype(np.int64)).tobytes())
        return Comparison(len(known), numbers, total - finished, tuple(sorted(versions)))

    def _planner(self) -> sqlite3.Connection:
        """A connection that can plan and writes nothing into the directory."""
        if os.path.isfile(self.database):
            self._connection = self._reader()
        else:
            self._refuse_old()
            self._connection = sqlite3.connect(":memory:", isolation_level=None)
            tables.make_tables(self._connection)
        return self._connection

    # -- reading ------------------------------------------------------------------------------

    def count(self, study: str | None = None) -> int:
        """Number of finished runs; 0 where there is no result directory."""
        if not os.path.isfile(self.database):
            self._refuse_old()
            return 0
        ((count,),) = self.query("SELECT count(*) FROM runs {where}", study)
        return int(count)

    def rows(self, study: str | None = None) -> Iterator[dict[str, Any]]:
        """Every finished run by column, also while a study is under way, in order of the plans.

        Raises
        ------
        InvalidInput
            If this is no result directory.
        """
        with self._reading() as connection:
            names = dict(tables.columns_of(connection))
            for rows in tables.batches(connection, names, study):
                yield from rows

    def columns(self) -> dict[str, str]:
        """Names and SQL types of the columns."""
        with self._reading() as connection:
            return dict(tables.columns_of(connection))

    def query(self, text: str, study: str | None = None, *more: object) -> list[tuple[Any, ...]]:
        """The rows of a query; ``{where}`` in it becomes the restriction to a study."""
        with self._reading() as connection:
            where, parameters = tables.restriction(study)
            return connection.execute(
                text.replace("{where}", where), (*parameters, *more)
            ).fetchall()

    def about(self, study: str | None = None) -> Mapping[str, Any]:
        """The description of a study, by default of the newest one; empty where there is none."""
        found = self.query("SELECT about FROM studies {where} ORDER BY used DESC LIMIT 1", study)
        if not found:
            return {}
        try:
            about = json.loads(found[0][0])
        except (TypeError, ValueError) as error:
            raise InvalidInput(
                f"{self.database}: what it says of a study is damaged ({error}); {ANEW}"
            ) from error
        if not (isinstance(about, dict) and about.keys() >= DESCRIBED):
            raise InvalidInput(f"{self.database} says nothing of its study; {ANEW}")
        return about

    def newest(self) -> str | None:
        """The study that this directory was last used for."""
        found = self.query("SELECT study FROM studies ORDER BY used DESC LIMIT 1")
        return found[0][0] if found else None

    def without_trajectory(self, run_ids: Iterable[str]) -> list[str]:
        """Those of the runs whose trajectory is not in the directory."""
        folder = self.trajectory_file("").parent
        there = {file.stem for file in folder.iterdir()} if os.path.isdir(folder) else set()
        return [run_id for run_id in run_ids if run_id not in there]

    def find(self, run_id: str) -> str:
        """The whole run_id of the finished run whose run_id begins with `run_id`.

        Raises
        ------
        InvalidInput
            If this is no result directory, or there is no such run, or more than one.
        """
        known = sorted(name for (name,) in self.query("SELECT run_id FROM runs"))
        found = [name for name in known if name.startswith(run_id)]
        if not known:
            raise InvalidInput(f"{self.root} has no runs")
        if not found:
            raise InvalidInput(f"{self.root} has no run '{run_id}'; {nearest(run_id, known)}")
        if len(found) > 1:
            raise InvalidInput(f"{len(found)} runs begin with '{run_id}'; give more of its digits")
        return str(found[0])

    def trajectory(self, run_id: str) -> Trajectory:
        """The trajectory of a run.

        Raises
        ------
        InvalidInput
            If there is none, or if its file is damaged.
        """
        file = self.trajectory_file(run_id)
        try:
            return read_trajectory(file)
        except FileNotFoundError as error:
            raise InvalidInput(f"run {run_id} has no trajectory: {file} does not exist") from error

    # -- helpers ------------------------------------------------------------------------------

    def _refuse_old(self) -> None:
        if os.path.isdir(self.root / "parts") and not os.path.isfile(self.database):
            raise InvalidInput(
                f"{self.root} holds results of an earlier version of congelation, which this one "
                "does not read; give another folder"
            )

    def _make_database(self) -> None:
        """Let the database appear with its tables, or leave it to another process to do so."""
        temporary = self.root / f".runs.sqlite.{os.getpid()}.tmp"
        with closing(sqlite3.connect(temporary)) as connection:
            tables.make_tables(connection)
            connection.commit()
        with suppress(FileExistsError):
            os.link(temporary, self.database)
        temporary.unlink()

    @contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        """A connection that only reads; a damaged file is said to be one."""
        with closing(self._reader()) as connection:
            try:
                yield connection
            except sqlite3.Error as error:
                raise InvalidInput(self._worded(error, "read")) from error

    def _reader(self) -> sqlite3.Connection:
        self._refuse_old()
        if not os.path.isfile(self.database):
            raise InvalidInput(
                f"{self.root} is no result directory: {self.database} does not exist"
            )
        try:
            uri = f"{self.database.absolute().as_uri()}?mode=ro"
            connection = sqlite3.connect(uri, uri=True, timeout=BUSY, isolation_level=None)
            try:
                self._refuse_foreign(connection)
            except BaseException:
                connection.close()
                raise
        except sqlite3.Error as error:
            raise InvalidInput(self._worded(error, "read")) from error
        return connection

    def _refuse_foreign(self, connection: sqlite3.Connection) -> None:
        """Raise InvalidInput where the database is not what `make_tables` made."""
        there = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
        if not there:
            raise InvalidInput(f"{self.database} is empty: no run was ever stored in it; {ANEW}")
        columns = {name for name, _ in tables.columns_of(connection)}
        if not (there >= tables.TABLES and columns >= tables.KEYS):
            raise InvalidInput(
                f"{self.database} was written by another program, or by a version of congelation "
                f"that this one does not read; {ANEW}"
            )

    def _worded(self, error: sqlite3.Error, done: str) -> str:
        """What an error of SQLite is to a user, and what is to be done."""
        code = getattr(error, "sqlite_errorcode", None)
        if code == sqlite3.SQLITE_NOTADB:
            return (
                f"{self.database} holds no results: another program wrote it, or its beginning is "
                f"damaged; {ANEW}"
            )
        # What cannot be decoded comes without a code.
        if code == sqlite3.SQLITE_CORRUPT or "decode" in str(error):
            return (
                f"{self.database} is damaged; {self.index.name} beside it may still hold the rows "
                f"of a finished study, to get them anew {ANEW}"
            )
        return f"{self.database} cannot be {done}: {error}"

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        if self._connection is None:
            self.create()
        connection = cast(sqlite3.Connection, self._connection)
        with self._errors():
            if not os.path.isfile(self.database):  # SQLite would go on in a file without a name
                raise StoreError(
                    f"{self.database} was removed while a study wrote into it; its runs are lost: "
                    "run it again"
                )
            connection.execute("BEGIN IMMEDIATE")
            try:
                yield connection
            except BaseException:
                if connection.in_transaction:
                    connection.execute("ROLLBACK")
                raise
            connection.execute("COMMIT")

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise StoreError(self._worded(error, "written")) from error


@dataclass(frozen=True)
class Comparison:
    """A plan compared with the finished runs of a directory.

    Parameters
    ----------
    total : int
        Runs of the plan.
    missing : array of int
        The numbers of those to do, in order.
    others : int
        Finished runs of the directory that the plan does not have.
    versions : tuple of str
        Versions of the code that the finished ones were done with.
    """

    total: int
    missing: array[int]
    others: int
    versions: tuple[str, ...]
