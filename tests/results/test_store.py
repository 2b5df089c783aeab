"""The result directory: what is written is read back, whole or not at all."""

from __future__ import annotations

import math
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from congelation.errors import CongelationError, InvalidInput
from congelation.places import StoreError, replace_whole
from congelation.results.identity import code_version, content_hash, file_hash
from congelation.results.record import STRETCHES, RunRecord, Steps, Trajectory
from congelation.results.results import Results, open_results
from congelation.results.store import Store
from congelation.results.trajectory_file import trajectory_bytes
from tests.studies import until

ABOUT = {"title": "A study", "figures": [], "varied": [], "metrics": {}, "swept": False}


def trajectory(scale: float = 1.0) -> Trajectory:
    time = np.linspace(0.0, 1.0, 11)
    values = scale * np.column_stack([np.sin(time), np.cos(time), time])
    columns = ("plant.x[1]", "plant.x[2]", "plant.xi")
    return Trajectory(time, columns, values, {"plant.x[1]": "m"})


def record(run_id: str, **values: object) -> RunRecord:
    known: dict[str, object] = {"variant": "one", "status": "COMPLETED", "study": "s"}
    return RunRecord(run_id=run_id, **{**known, **values})  # type: ignore[arg-type]


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "deep" / "results")
    store.create()
    store.begin("s", ABOUT)
    return store


def test_records_come_back_as_they_were(store: Store) -> None:
    records = [
        record(
            run_id,
            number=number,
            settings={"p.flag": bool(number), "p.k": 0.5 * number, "p.n": number, "p.s": "12"},
            metrics={"peak": peak, "none": None},
            deviations={"p.x": 1e-3},
            fmus={"p": "5e1f"},
            trust_error=0.5,
            trust_verdict="good",
            steps=3,
        )
        for number, (run_id, peak) in enumerate([("a", 1.5), ("b", None), ("c", math.inf)])
    ]
    store.add(records[::-1])
    assert list(Results(store.root).runs) == records
    store.close()
    assert list(Results(store.root).runs) == records
    assert type(Results(store.root).runs[1].settings["p.flag"]) is bool


def test_a_new_record_of_a_run_replaces_the_old_one(store: Store) -> None:
    store.add([record("a", status="TIMED_OUT")])
    store.add([record("a"), record("b")])
    assert [(r.run_id, r.status) for r in Results(store.root).runs] == [
        ("a", "COMPLETED"),
        ("b", "COMPLETED"),
    ]


def test_studies_with_other_columns_share_a_directory(store: Store) -> None:
    store.add([record("x", settings={"p.r": 1.0}, metrics={"m": 1.0})])
    store.begin("t", ABOUT)
    store.add([record("y", study="t", settings={"p.q": True}, metrics={"n": 2.0})])
    first, second = Results(store.root).runs
    assert first.settings == {"p.r": 1.0, "p.q": None}
    assert second.settings == {"p.r": None, "p.q": True}
    assert [r.run_id for r in Results(store.root, "t").runs] == ["y"]


def test_runs_parquet_has_every_record_and_its_types(store: Store) -> None:
    store.add([record("a", number=0, settings={"k": 1, "flag": True}, metrics={"m": math.nan})])
    store.add([record("b", number=1, settings={"k": 0.5, "flag": None}, metrics={"m": math.inf})])
    table = pq.read_table(store.export())
    assert table["run_id"].to_pylist() == ["a", "b"]
    assert table["set.k"].to_pylist() == [1.0, 0.5]
    assert table["set.flag"].to_pylist() == [True, None]
    assert table["metric.m"].to_pylist() == [None, math.inf]  # SQLite has no nan


def test_trajectories_are_plain_parquet_and_come_back(store: Store) -> None:
    store.write_trajectory("a", trajectory_bytes(trajectory(2)))
    table = pq.read_table(store.trajectory_file("a"))
    assert table.column_names == ["time", "plant.x[1]", "plant.x[2]", "plant.xi"]
    assert table.schema.field("time").metadata == {b"unit": b"s"}
    read = store.trajectory("a")
    assert read.steps is None
    assert read.columns == trajectory().columns
    assert read.units == {"plant.x[1]": "m", "plant.x[2]": "", "plant.xi": ""}
    assert np.array_equal(read.time, trajectory().time)
    assert np.array_equal(read.values, trajectory(2).values)


def test_a_vector_is_its_elements_and_nothing_that_begins_alike() -> None:
    assert trajectory().group("plant.x") == ("plant.x[1]", "plant.x[2]")
    assert trajectory().group("plant.x[2]") == ("plant.x[2]",)
    assert trajectory().group("plant.y") == ()


def test_a_plan_is_compared_with_what_is_finished(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.create()
    store.begin("s", ABOUT)
    store.add([record("b"), record("e"), record("d", status="TIMED_OUT", code_version="1")])
    store.close()
    runs = list(enumerate(["a", "b", "a", "c", "d"]))
    found = Store(tmp_path).plan("p", runs)
    assert (found.total, found.others, list(found.missing)) == (4, 1, [0, 3])
    assert set(found.versions) == {"", "1"}
    assert list(Store(tmp_path).plan("p", runs, ["TIMED_OUT"]).missing) == [0, 3, 4]
    assert list(Store(tmp_path).plan("p", runs, None).missing) == [0, 1, 3, 4]
    assert list(Store(tmp_path).plan("none", []).missing) == []


def test_a_plan_that_was_stored_is_not_computed_again(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.create()
    store.add([record("b", study="old", number=7), record("e", study="old", number=8)])
    store.plan("p", [(3, "a"), (5, "b")])
    store.begin("s", ABOUT)
    store.close()
    assert [(r.run_id, r.study, r.number) for r in Results(tmp_path).runs] == [
        ("e", "old", 8),
        ("b", "s", 5),
    ]

    def refused() -> Iterator[tuple[int, str]]:
        raise AssertionError("the plan is computed")
        yield

    found = Store(tmp_path).plan("p", refused())
    assert (found.total, list(found.missing)) == (2, [3])
    with pytest.raises(AssertionError, match="the plan is computed"):
        Store(tmp_path).plan("q", refused())


def test_a_table_of_runs(store: Store) -> None:
    store.add([record(c, number=n, metrics={"m": n}) for n, c in enumerate("abc")])
    runs = Results(store.root).runs
    assert len(runs) == 3
    assert runs["metric.m"].tolist() == runs["m"].tolist() == [0, 1, 2]
    assert runs["status"].tolist() == ["COMPLETED"] * 3
    assert (runs[-1].run_id, [r.run_id for r in runs[:2]]) == ("c", ["a", "b"])
    with pytest.raises(IndexError):
        runs[3]
    with pytest.raises(InvalidInput, match=r"did you mean 'metric\.m'"):
        runs["metric.n"]


def test_what_is_shown_is_short(store: Store) -> None:
    store.add([record(f"{n:04d}", number=n, metrics={"m<": n}) for n in range(50)])
    text = repr(open_results(store.root))
    assert len(text.splitlines()) <= 10
    assert text.splitlines()[0] == f"A study: 50 runs in {store.root}"
    assert text.splitlines()[-1] == ".. and 44 more"
    assert "<th>m&lt;</th>" in open_results(store.root)._repr_html_()


def test_a_data_frame(store: Store) -> None:
    store.add([record("a", metrics={"m": 1.0}), record("b", metrics={"m": 2.0})])
    frame = Results(store.root).to_pandas()
    assert frame["metric.m"].tolist() == [1.0, 2.0]


def test_without_pandas_one_line_says_so(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InvalidInput, match=r"pip install congelation\[pandas\]"):
        Results(store.root).to_pandas()


def test_a_write_that_fails_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    file = tmp_path / "file.txt"
    file.write_text("old")

    def half(temporary: Path) -> None:
        temporary.write_text("hal")
        raise OSError(28, "No space left on device")

    with pytest.raises(CongelationError, match=r"file\.txt cannot be written: .*No space left"):
        replace_whole(file, half)
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]


FULL_DISK = """
import resource, sys
from pathlib import Path
from congelation.errors import CongelationError
from congelation.results.store import Store
from tests.results.test_store import ABOUT, record
store = Store(Path(sys.argv[1]))
store.create()
store.begin("s", ABOUT)
store.add([record("a", message="x" * 1000)])
resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, resource.RLIM_INFINITY))
try:
    store.add([record(str(k), message="x" * 1000) for k in range(1000)])
except CongelationError as error:
    print(error)
print(store.count())
"""


def test_a_full_disk_is_one_line_and_loses_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-W", "error", "-c", FULL_DISK, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    message, count = done.stdout.splitlines()
    assert "runs.sqlite cannot be written: " in message
    assert count == "1"
    assert [r.run_id for r in Results(tmp_path).runs] == ["a"]


KILLED = """
import itertools, sys
from pathlib import Path
from congelation.results.store import Store
from tests.results.test_store import ABOUT, record
store = Store(Path(sys.argv[1]))
store.create()
store.begin("s", ABOUT)
for batch in itertools.count():
    store.add([record(f"{batch}-{k}", number=100 * batch + k) for k in range(100)])
    print(batch, flush=True)
"""


def test_a_killed_writer_loses_no_committed_batch(tmp_path: Path) -> None:
    command = [sys.executable, "-c", KILLED, str(tmp_path / "out")]
    with (tmp_path / "log").open("wb") as log:
        writer = subprocess.Popen(command, stdout=log)
        until(lambda: len((tmp_path / "log").read_text().split()) >= 5)
        os.kill(writer.pid, signal.SIGKILL)
        writer.wait()
    committed = 1 + int((tmp_path / "log").read_text().split()[-1])
    ids = [r.run_id for r in Results(tmp_path / "out").runs]
    assert len(ids) == len(set(ids))
    assert len(ids) in (100 * committed, 100 * (committed + 1))


def test_places_that_cannot_hold_results(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInput, match=r"no files can be written there"):
        Store(tmp_path / "file" / "results").create()
    with pytest.raises(InvalidInput, match="results /proc/results: no files can be written"):
        Store(Path("/proc/results")).create()


def test_an_old_result_directory_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    for use in (Store(tmp_path).create, Store(tmp_path).count, lambda: open_results(tmp_path)):
        with pytest.raises(InvalidInput, match="holds results of an earlier version"):
            use()


def test_directories_that_hold_no_results(tmp_path: Path, store: Store) -> None:
    with pytest.raises(InvalidInput, match=r"is no result directory: .*runs\.sqlite does not ex"):
        open_results(tmp_path)
    with pytest.raises(InvalidInput, match="run a has no trajectory"):
        store.trajectory("a")
    store.write_trajectory("a", trajectory_bytes(trajectory())[:100])
    with pytest.raises(InvalidInput, match=r"a\.parquet is damaged: "):
        store.trajectory("a")
    (tmp_path / "runs.sqlite").write_bytes(b"no database" * 100)
    with pytest.raises(InvalidInput, match=r"runs\.sqlite holds no results: another program"):
        open_results(tmp_path)
    with pytest.raises(StoreError, match=r"runs\.sqlite holds no results: another program"):
        Store(tmp_path).create()


def test_identifiers(tmp_path: Path) -> None:
    assert content_hash({"a": 1.0, "b": [2]}) == content_hash({"b": [2], "a": 1.0})
    assert content_hash({"a": 1.0}) != content_hash({"a": 1.0 + 2**-52})
    assert content_hash({"a": True}) != content_hash({"a": 1})
    (tmp_path / "empty").write_bytes(b"")
    assert file_hash(tmp_path / "empty").startswith("e3b0c44298fc1c14")
    assert len(code_version().partition("+")[2]) == 12


def test_the_database_can_be_read_where_nothing_can_be_written(store: Store) -> None:
    store.add([record("a")])
    store.close()
    assert [file.name for file in store.root.glob("runs.*")] == ["runs.sqlite"]
    with sqlite3.connect(f"file:{store.database}?immutable=1", uri=True) as connection:
        assert connection.execute("SELECT count(*) FROM runs").fetchall() == [(1,)]


def test_steps_are_kept_with_the_trajectory(store: Store) -> None:
    """A jump stands twice among the points and is no step."""
    steps = Steps.between(np.array([0.0, 0.5, 0.75, 0.75, 1.0]))
    assert steps.count == 3
    assert steps.time.tolist() == [0.5, 0.75, 1.0]
    assert steps.length.tolist() == [0.5, 0.25, 0.25]
    store.write_trajectory("a", trajectory_bytes(replace(trajectory(), steps=steps)))
    read = store.trajectory("a").steps
    assert read is not None
    assert (read.count, read.time.tolist(), read.length.tolist()) == (
        3,
        [0.5, 0.75, 1.0],
        [0.5, 0.25, 0.25],
    )


def test_of_many_steps_extremes_are_kept_and_of_equal_ones_the_ends() -> None:
    lengths = np.random.default_rng(1).uniform(0.5, 1.0, 5000)
    lengths[1234], lengths[4321] = 0.01, 7.0
    steps = Steps.between(np.concatenate([[0.0], np.cumsum(lengths)]))
    assert steps.count == 5000
    assert len(steps.time) <= 2 * STRETCHES + 2
    assert (steps.length.min(), steps.length.max()) == pytest.approx((0.01, 7.0))
    assert steps.time[-1] == pytest.approx(lengths.sum())
    equal = Steps.between(np.arange(0, 10001) * 1e-3)
    assert equal.count == 10000
    assert equal.time.tolist() == [0.001, 10.0]
    nothing = Steps.between(np.array([0.0]))
    assert (nothing.count, len(nothing.length)) == (0, 0)


def test_a_removed_directory_is_told_by_the_next_commit(tmp_path: Path) -> None:
    store = Store(tmp_path / "out")
    store.create()
    shutil.rmtree(tmp_path / "out")
    with pytest.raises(StoreError, match="was removed while a study wrote into it"):
        store.add([])


def test_pages_that_are_damaged_are_named(store: Store) -> None:
    store.add([record(f"r{k}", message="x" * 200) for k in range(300)])
    store.close()
    content = bytearray(store.database.read_bytes())
    content[4200::97] = bytes(b ^ 0xFF for b in content[4200::97])
    store.database.write_bytes(content)
    with pytest.raises(InvalidInput, match=r"runs\.sqlite is damaged; runs\.parquet beside it may"):
        list(Results(store.root).runs)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (("ALTER TABLE studies RENAME TO other",), "was written by another program, or by a versi"),
        (("DROP TABLE runs",), "was written by another program, or by a version of congelation"),
        (("ALTER TABLE runs DROP COLUMN status",), "was written by another program"),
        (
            ("DROP TABLE runs", "DROP TABLE studies", "DROP TABLE plans"),
            "is empty: no run was ever",
        ),
    ],
)
def test_a_database_of_another_kind_is_named_and_what_to_do(
    store: Store, changes: tuple[str, ...], message: str
) -> None:
    store.close()
    with sqlite3.connect(store.database) as connection:
        for change in changes:
            connection.execute(change)
    connection.close()
    for use in (lambda: open_results(store.root), Store(store.root).count):
        with pytest.raises(InvalidInput, match=f"{message}.*; move it away and run the scenario"):
            use()


def test_a_column_of_a_later_version_is_left_out(store: Store) -> None:
    store.add([record("a")])
    store.close()
    with sqlite3.connect(store.database) as connection:
        connection.execute("ALTER TABLE runs ADD COLUMN later REAL")
    connection.close()
    assert list(open_results(store.root).runs) == [record("a")]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("DELETE FROM studies", "says nothing of its study"),
        ("UPDATE studies SET about = '{}'", "says nothing of its study"),
        ("UPDATE studies SET about = '[1]'", "says nothing of its study"),
        ("UPDATE studies SET about = '{'", "what it says of a study is damaged"),
        ("UPDATE studies SET about = NULL", "what it says of a study is damaged"),
    ],
)
def test_a_study_that_is_damaged_is_named(store: Store, change: str, message: str) -> None:
    store.close()
    with sqlite3.connect(store.database) as connection:
        connection.execute(change)
    connection.close()
    with pytest.raises(InvalidInput, match=message):
        Results(store.root).study()


def test_a_directory_that_is_gone_has_no_runs_to_show(store: Store) -> None:
    results = open_results(store.root)
    store.close()
    store.database.unlink()
    assert repr(results).endswith("is no result directory")
    with pytest.raises(InvalidInput, match="is no result directory"):
        len(results.runs)


def test_wrong_ways_to_name_a_run(store: Store) -> None:
    store.add([record("r1")])
    store.write_trajectory("r1", trajectory_bytes(trajectory()))
    results = Results(store.root)
    np.testing.assert_equal(results.trajectory(results.runs[0]).time, trajectory().time)
    with pytest.raises(InvalidInput, match="run_id = 5 is not valid; give a text or a RunRecord"):
        results.trajectory(5)  # type: ignore[arg-type]
    with pytest.raises(InvalidInput, match=r"runs\[1.5\]: give a number, a slice or the name"):
        results.runs[1.5]  # type: ignore[call-overload]


def test_a_trajectory_that_is_gone_is_missing_in_a_plan(store: Store) -> None:
    store.add([record("a1"), record("a2"), record("a3", status="TIMED_OUT")])
    store.write_trajectory("a1", trajectory_bytes(trajectory()))
    plan = [(0, "a1"), (1, "a2"), (2, "a3")]
    assert list(store.plan("p", plan).missing) == []
    assert list(store.plan("p", plan, trajectories=True).missing) == [1]
    assert Results(store.root).lost_trajectories() == ["a2"]
