"""Nothing wrong passes in silence: rows of the table of mutations, applied at random.

Each row once in `make test`; in `make fuzz` for as many seconds as CONGELATION_FUZZ_SECONDS says.
"""

from __future__ import annotations

import os
import random
import re
import time
from pathlib import Path

import pytest

from congelation.results.results import open_results
from tests.fuzz.mutations import ARCHIVES, KEYS, Mutation
from tests.scenarios import FMUS, SCALAR
from tests.studies import command

SEED = 20180612


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """The row of the scenario as it is."""
    return outcome(tmp_path_factory.mktemp("plain"), SCALAR)[2]


def outcome(folder: Path, text: str) -> tuple[int, str, dict[str, object]]:
    """Exit code, stderr and the first row of a run of a scenario."""
    file, out = folder / "loop.toml", folder / "out"
    file.write_text(text, encoding="utf-8")
    done = command("run", file, "--out", out, "--progress", "quiet")
    row = next(iter(open_results(out).runs.rows())) if done.returncode == 0 else {}
    return done.returncode, done.stderr, row


def apply(mutation: Mutation, rng: random.Random, folder: Path, plain: dict[str, object]) -> None:
    """Apply a row, and compare what comes of it with what it says."""
    old, new = mutation.change(rng)
    assert old in SCALAR
    code, errors, row = outcome(folder, SCALAR.replace(old, new, 1))
    what = f"{mutation.name}: {old!r} -> {new!r}: {code}, {errors}"
    assert "Traceback" not in errors, what
    assert code == mutation.code, what
    lines = errors.splitlines()
    assert all(line.startswith("congelation: ") for line in lines), what
    if mutation.says:
        assert lines, what
        assert re.search(mutation.says, lines[-1]), what
    else:
        assert not lines, what
    if mutation.same:
        assert row[mutation.same] == plain[mutation.same], what


def damage(row: int, rng: random.Random, folder: Path) -> None:
    """Apply a row of those of archives: whatever reads the FMU refuses it in one line."""
    name, change, says = ARCHIVES[row]
    file = folder / f"Damaged{rng.getrandbits(40):x}.fmu"
    file.write_bytes(change(rng, (FMUS / "ScalarPlant.fmu").read_bytes()))
    done = command("info", file)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), (name, done.stderr)
    assert re.search(says, done.stderr), (name, done.stderr)
    code, errors, _ = outcome(folder, SCALAR.replace(f"{FMUS}/ScalarPlant.fmu", str(file)))
    assert (code, errors.count("\n")) == (2, 1), (name, errors)
    assert re.search(says, errors), (name, errors)


@pytest.mark.parametrize("mutation", KEYS, ids=lambda m: m.name)
def test_each_row_has_the_outcome_that_the_table_says(
    tmp_path: Path, mutation: Mutation, plain: dict[str, object]
) -> None:
    apply(mutation, random.Random(SEED), tmp_path, plain)


@pytest.mark.parametrize("row", range(len(ARCHIVES)), ids=[row[0] for row in ARCHIVES])
def test_a_damaged_fmu_is_refused_in_one_line(tmp_path: Path, row: int) -> None:
    damage(row, random.Random(SEED), tmp_path)


@pytest.mark.fuzz
def test_rows_at_random(tmp_path_factory: pytest.TempPathFactory, plain: dict[str, object]) -> None:
    """For the seconds that `make fuzz` gives; one row in `make test`, which has them all above."""
    seconds = float(os.environ.get("CONGELATION_FUZZ_SECONDS", "0"))
    seed = random.SystemRandom().getrandbits(32) if seconds else SEED
    rng, end = random.Random(seed), time.monotonic() + seconds
    done = 0
    while done == 0 or time.monotonic() < end:
        folder = tmp_path_factory.mktemp("row")
        place = rng.randrange(len(KEYS) + len(ARCHIVES))
        try:
            if place < len(KEYS):
                apply(KEYS[place], rng, folder, plain)
            else:
                damage(place - len(KEYS), rng, folder)
        except Exception as error:
            raise AssertionError(f"seed {seed}, row {place}, after {done} rows") from error
        done += 1
