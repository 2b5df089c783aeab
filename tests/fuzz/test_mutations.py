"""Nothing wrong passes in silence: rows of the table of mutations, applied at random.

Each row once in `make test`; in `make fuzz` for as many seconds as CONGELATION_FUZZ_SECONDS says.
"""

from __future__ import annotations

import io
import os
import random
import re
import shutil
import time
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from congelation.results.results import open_results
from congelation.scenario.load import load_scenario
from congelation.scenario.ssp import write_ssp
from tests.fuzz.mutations import ARCHIVES, FILES, KEYS, SPEC, SPECS, SYSTEMS, Mutation
from tests.scenarios import FMUS, SCALAR, write
from tests.studies import command

SEED = 20180612


@dataclass(frozen=True)
class Originals:
    """What is mutated, as it is, and the rows of its runs."""

    archive: bytes
    scenario_row: Mapping[str, object]
    archive_row: Mapping[str, object]


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> Originals:
    """The archive of the scenario, and what comes of both."""
    folder = tmp_path_factory.mktemp("plain")
    code, errors, row = outcome(folder, write(folder))
    assert (code, errors) == (0, "")
    archive = folder / "loop.ssp"
    write_ssp(load_scenario(folder / "loop.toml"), archive)
    code, errors, archived = outcome(folder / "archive", archive)
    assert (code, errors) == (0, "")
    return Originals(archive.read_bytes(), row, archived)


def outcome(folder: Path, file: Path) -> tuple[int, str, dict[str, object]]:
    """Exit code, stderr and the first row of a run of a scenario or an archive."""
    out = folder / "out"
    done = command("run", file, "--out", out, "--progress", "quiet")
    row = next(iter(open_results(out).runs.rows())) if done.returncode == 0 else {}
    return done.returncode, done.stderr, row


def scenario_of(folder: Path, mutation: Mutation, rng: random.Random, text: str) -> Path:
    """A scenario or spec with a mutation."""
    old, new = mutation.change(rng)
    assert old in text
    file = folder / "loop.toml"
    file.write_text(text.replace(old, new, 1), encoding="utf-8")
    return file


def archive_of(folder: Path, mutation: Mutation, rng: random.Random, content: bytes) -> Path:
    """An SSP archive with a mutation of the text of one of its files."""
    old, new = mutation.change(rng)
    file = folder / "loop.ssp"
    with zipfile.ZipFile(io.BytesIO(content)) as before, zipfile.ZipFile(file, "w") as after:
        for name in before.namelist():
            data = before.read(name)
            if name == mutation.entry:
                assert old.encode() in data
                data = data.replace(old.encode(), new.encode(), 1)
            after.writestr(name, data)
    return file


def apply(mutation: Mutation, rng: random.Random, folder: Path, originals: Originals) -> None:
    """Apply a row, and compare what comes of it with what it says."""
    state = rng.getstate()
    row: Mapping[str, object] = {}
    same = originals.scenario_row
    if mutation in SPECS:
        file = scenario_of(folder, mutation, rng, SPEC)
        done = command("build", file, "--out", folder / "fmus")
        code, errors = done.returncode, done.stderr
    elif mutation in SYSTEMS:
        file = archive_of(folder, mutation, rng, originals.archive)
        code, errors, row = outcome(folder, file)
        same = originals.archive_row
    else:
        file = scenario_of(folder, mutation, rng, SCALAR)
        code, errors, row = outcome(folder, file)
    rng.setstate(state)
    what = f"{mutation.name}: {mutation.change(rng)}: {code}, {errors}"
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
        assert row[mutation.same] == same[mutation.same], what


def damage(row: int, rng: random.Random, folder: Path) -> None:
    """Apply a row of those of archives: whatever reads the FMU refuses it in one line."""
    name, change, says = ARCHIVES[row]
    file = folder / f"Damaged{rng.getrandbits(40):x}.fmu"
    file.write_bytes(change(rng, (FMUS / "ScalarPlant.fmu").read_bytes()))
    done = command("info", file)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), (name, done.stderr)
    assert re.search(says, done.stderr), (name, done.stderr)
    scenario = write(folder, SCALAR, (f"{FMUS}/ScalarPlant.fmu", str(file)))
    code, errors, _ = outcome(folder, scenario)
    assert (code, errors.count("\n")) == (2, 1), (name, errors)
    assert re.search(says, errors), (name, errors)


def damage_archive(row: int, rng: random.Random, folder: Path, originals: Originals) -> None:
    """Apply a row of those of SSP archives: `run` refuses it in one line."""
    name, change, says = FILES[row]
    file = folder / "damaged.ssp"
    file.write_bytes(change(rng, originals.archive))
    code, errors, _ = outcome(folder, file)
    assert (code, errors.count("\n")) == (2, 1), (name, errors)
    assert re.search(says, errors), (name, errors)


@pytest.mark.parametrize("mutation", [*KEYS, *SPECS, *SYSTEMS], ids=lambda m: m.name)
def test_each_row_has_the_outcome_that_the_table_says(
    tmp_path: Path, mutation: Mutation, originals: Originals
) -> None:
    apply(mutation, random.Random(SEED), tmp_path, originals)


@pytest.mark.parametrize("row", range(len(ARCHIVES)), ids=[row[0] for row in ARCHIVES])
def test_a_damaged_fmu_is_refused_in_one_line(tmp_path: Path, row: int) -> None:
    damage(row, random.Random(SEED), tmp_path)


@pytest.mark.parametrize("row", range(len(FILES)), ids=[row[0] for row in FILES])
def test_a_damaged_archive_is_refused_in_one_line(
    tmp_path: Path, row: int, originals: Originals
) -> None:
    damage_archive(row, random.Random(SEED), tmp_path, originals)


@pytest.mark.fuzz
def test_rows_at_random(tmp_path_factory: pytest.TempPathFactory, originals: Originals) -> None:
    """For the seconds that `make fuzz` gives; one row in `make test`, which has them all above."""
    seconds = float(os.environ.get("CONGELATION_FUZZ_SECONDS", "0"))
    seed = random.SystemRandom().getrandbits(32) if seconds else SEED
    rng, end = random.Random(seed), time.monotonic() + seconds
    texts = [*KEYS, *SPECS, *SYSTEMS]
    done = 0
    while done == 0 or time.monotonic() < end:
        folder = tmp_path_factory.mktemp("row")
        place = rng.randrange(len(texts) + len(ARCHIVES) + len(FILES))
        damaged = place - len(texts)
        try:
            if damaged < 0:
                apply(texts[place], rng, folder, originals)
            elif damaged < len(ARCHIVES):
                damage(damaged, rng, folder)
            else:
                damage_archive(damaged - len(ARCHIVES), rng, folder, originals)
        except Exception as error:
            raise AssertionError(f"seed {seed}, row {place}, after {done} rows") from error
        shutil.rmtree(folder)
        done += 1
