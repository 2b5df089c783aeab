"""The result directory: what is written is read back, whole or not at all."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from congelation.errors import CongelationError, InvalidInput
from congelation.results.identity import code_version, content_hash, file_hash
from congelation.results.records import Trajectory
from congelation.results.store import Store, replace_whole

ABOUT = {"title": "A study", "figures": []}


def trajectory(scale: float = 1.0) -> Trajectory:
    time = np.linspace(0.0, 1.0, 11)
    values = scale * np.column_stack([np.sin(time), np.cos(time), time])
    columns = ("plant.x[1]", "plant.x[2]", "plant.xi")
    return Trajectory(time, columns, values, {"plant.x[1]": "m"})


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "deep" / "results")
    store.create()
    return store


def test_runs_and_trajectories_come_back_as_they_were(store: Store) -> None:
    rows = [
        {"run_id": "a", "variant": "one", "flag": True, "peak": 1.5, "seed": None},
        {"run_id": "b", "variant": "two", "flag": False, "peak": None, "seed": None},
        {"run_id": "c", "variant": "three", "flag": False, "peak": float("inf"), "seed": None},
    ]
    for scale, row in enumerate(rows):
        store.write(row, trajectory(scale))
    store.compact(["c", "a", "b"], ABOUT)
    study = store.read()
    assert study.rows == (rows[2], rows[0], rows[1])
    assert study.about == ABOUT
    read = store.trajectory("c")
    assert read.columns == trajectory().columns
    assert read.units == {"plant.x[1]": "m", "plant.x[2]": "", "plant.xi": ""}
    assert np.array_equal(read.time, trajectory().time)
    assert np.array_equal(read.values, trajectory(2).values)


def test_files_are_plain_parquet(store: Store) -> None:
    store.write({"run_id": "a"}, trajectory())
    table = pq.read_table(store.trajectory_file("a"))
    assert table.column_names == ["time", "plant.x[1]", "plant.x[2]", "plant.xi"]
    assert table.schema.field("time").metadata == {b"unit": b"s"}


def test_a_vector_is_its_elements_and_nothing_that_begins_alike() -> None:
    assert trajectory().group("plant.x") == ("plant.x[1]", "plant.x[2]")
    assert trajectory().group("plant.x[2]") == ("plant.x[2]",)
    assert trajectory().group("plant.y") == ()


def test_columns_that_only_some_runs_have_are_empty_in_the_others(store: Store) -> None:
    store.write({"run_id": "a", "r": 1.0}, trajectory())
    store.write({"run_id": "b", "epsilon": 2.0}, trajectory())
    store.compact(["a", "b"], ABOUT)
    assert store.read().rows == (
        {"run_id": "a", "r": 1.0, "epsilon": None},
        {"run_id": "b", "r": None, "epsilon": 2.0},
    )


def test_a_new_state_of_the_scenario_replaces_the_old_one(store: Store) -> None:
    store.write({"run_id": "old"}, trajectory())
    store.compact(["old"], ABOUT)
    assert store.replaceable() == {"old"}
    store.write({"run_id": "new"}, trajectory())
    store.compact(["new"], ABOUT)
    assert store.finished() == {"old", "new"}
    store.remove(["old"])
    assert store.finished() == {"new"}
    assert [file.name for file in store.root.glob("*/*")] == ["new.parquet", "new.parquet"]


def test_a_new_attempt_leaves_nothing_of_the_old_one(store: Store) -> None:
    assert store.written("a") is None
    store.write({"run_id": "a", "status": "SLAVE_FAILED"}, trajectory())
    first = store.written("a")
    store.write({"run_id": "a", "status": "TIMED_OUT"})
    second = store.written("a")
    assert first is not None
    assert second is not None
    assert first < second
    assert store.row("a")["status"] == "TIMED_OUT"
    assert not store.trajectory_file("a").exists()


def test_a_sweep_is_not_replaced(store: Store) -> None:
    assert store.replaceable() == set()
    store.write({"run_id": "a"})
    store.compact(["a"], {**ABOUT, "sweep": {}})
    with pytest.raises(InvalidInput, match="holds a sweep; give another directory"):
        store.replaceable()


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
from tests.results.test_store import trajectory
store = Store(Path(sys.argv[1]))
store.create()
resource.setrlimit(resource.RLIMIT_FSIZE, (200, 200))
try:
    store.write({"run_id": "a"}, trajectory())
except CongelationError as error:
    print(error)
    print(sorted(store.finished()), sorted(p.name for p in store.root.glob("trajectories/*")))
"""


def test_a_full_disk_is_one_line_and_leaves_no_half_file(tmp_path: Path) -> None:
    command = [sys.executable, "-W", "error", "-c", FULL_DISK, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    message, rest = done.stdout.splitlines()
    assert "a.parquet cannot be written: " in message
    assert rest == "[] []"


def test_places_that_cannot_hold_results(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInput, match=r"results cannot be written to .*file"):
        Store(tmp_path / "file" / "results").create()
    with pytest.raises(InvalidInput, match="results cannot be written to /proc"):
        Store(Path("/proc/results")).create()


def test_directories_that_hold_no_results(tmp_path: Path, store: Store) -> None:
    with pytest.raises(InvalidInput, match=r"is no result directory: .*runs\.parquet does not ex"):
        Store(tmp_path).read()
    with pytest.raises(InvalidInput, match="run a has no trajectory"):
        store.trajectory("a")
    store.write({"run_id": "a"}, trajectory())
    store.compact(["a"], ABOUT)
    store.trajectory_file("a").write_bytes(store.trajectory_file("a").read_bytes()[:100])
    with pytest.raises(InvalidInput, match=r"a\.parquet is damaged: "):
        store.trajectory("a")
    store.index.write_bytes(b"")
    with pytest.raises(InvalidInput, match=r"runs\.parquet is damaged: "):
        store.read()
    pq.write_table(pq.read_table(store.part_file("a")), store.index)
    with pytest.raises(InvalidInput, match=r"runs\.parquet was not written by congelation"):
        store.read()


def test_identifiers(tmp_path: Path) -> None:
    assert content_hash({"a": 1.0, "b": [2]}) == content_hash({"b": [2], "a": 1.0})
    assert content_hash({"a": 1.0}) != content_hash({"a": 1.0 + 2**-52})
    assert content_hash({"a": True}) != content_hash({"a": 1})
    (tmp_path / "empty").write_bytes(b"")
    assert file_hash(tmp_path / "empty").startswith("e3b0c44298fc1c14")
    assert len(code_version().partition("+")[2]) == 12


def test_many_rows_are_compacted_in_order_and_types_meet(store: Store) -> None:
    """More than are joined at a time; a column that is empty, whole or not there at first."""
    count = 600
    names = [f"{k:04d}" for k in range(count)]
    for k, name in enumerate(names):
        late = {"late": 0.5 * k} if k >= count // 2 else {}
        store.write({"run_id": name, "number": k if k < 300 else 0.5 + k, "seed": None, **late})
    store.compact(names[::-1], ABOUT)

    rows = store.read().rows
    assert [row["run_id"] for row in rows] == names[::-1]
    assert rows[0] == {"run_id": "0599", "number": 599.5, "seed": None, "late": 299.5}
    assert rows[-1] == {"run_id": "0000", "number": 0.0, "seed": None, "late": None}
    assert store.rows() == rows
