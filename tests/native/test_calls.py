"""Native FMUs under AddressSanitizer and UndefinedBehaviourSanitizer: calls in a random order.

`make fuzz` goes on with new seeds for as long as CONGELATION_FUZZ_SECONDS says.
"""

from __future__ import annotations

import os
import random
import re
import shutil
import subprocess
import time
from pathlib import Path

import fmpy
import pytest

from tests.native.test_twins import NATIVE

CHECKED = ("ObserverFormPlant", "OutputFeedbackController", "Reference", "Delay")
FLAGS = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
CALLS = 20_000
REMEDY = "make system-packages-further installs it"
needs_valgrind = pytest.mark.skipif(
    shutil.which("valgrind") is None,
    reason=f"there is no valgrind; {REMEDY}",
)
in_fuzz = pytest.mark.skipif(
    "CONGELATION_FUZZ_SECONDS" not in os.environ, reason="it takes long; make fuzz runs it"
)
# Debian's packages of a version call it by that.
CLANG = shutil.which("clang") or shutil.which("clang-14")


Objects = dict[tuple[bytes, ...], Path]
"""Compiled files by what they hold: their text and that of the headers beside them."""


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """By FMU: its sources with the driver, under the sanitizers.

    Of what is the same in all FMUs, one object serves all: compiling it takes four seconds.
    """
    objects: Objects = {}
    return {
        name: compiled(tmp_path_factory.mktemp(name), name, FLAGS, objects=objects)
        for name in CHECKED
    }


def compiled(
    folder: Path,
    name: str,
    flags: tuple[str, ...],
    compiler: str = "gcc",
    objects: Objects | None = None,
) -> Path:
    """The sources of an FMU with the driver, as a program."""
    sources = Path(fmpy.extract(str(NATIVE / f"{name}.fmu"), str(folder))) / "sources"
    files = [Path(__file__).with_name("calls.c"), *sorted(sources.glob("*.c"))]
    headers = [header.read_bytes() for header in sorted(sources.glob("*.h"))]
    program = folder / "calls"
    (folder / "table.csv").write_text("time,value\n0,1\n0.013,-0.5\n0.05,2\n", "utf-8")
    command = [compiler, *flags, f"-I{sources}"]
    kept = {} if objects is None else objects
    parts = []
    for file in files:
        key = (file.read_bytes(), *headers)
        if key not in kept:
            kept[key] = folder / f"{file.stem}.o"
            subprocess.run([*command, "-c", file, "-o", kept[key]], check=True)
        parts.append(kept[key])
    subprocess.run([*command, *parts, "-lm", "-o", program], check=True)
    return program


def run(
    program: Path, name: str, seed: int, calls: int = CALLS, under: tuple[str, ...] = ()
) -> int:
    """How many steps were taken among the calls; a fault ends the test, with the seed."""
    description = fmpy.read_model_description(str(NATIVE / f"{name}.fmu"))
    variables = len(description.modelVariables)
    done = subprocess.run(
        [*under, str(program), description.guid, str(variables), str(seed), str(calls)],
        cwd=program.parent,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, f"{name}, seed {seed}: {done.stderr[-4000:]}"
    return int(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("name", CHECKED)
def test_the_sanitizers_find_nothing(programs: dict[str, Path], name: str) -> None:
    assert sum(run(programs[name], name, seed) for seed in (1, 2)) > 100


@pytest.mark.fuzz
@pytest.mark.slow
@in_fuzz
@needs_valgrind
def test_valgrind_finds_nothing(tmp_path: Path) -> None:
    """Reads of memory that was never written, which the sanitizers do not see, and leaks."""
    for name in CHECKED:
        program = compiled(tmp_path / name, name, ("-g", "-O1"))
        under = ("valgrind", "--quiet", "--error-exitcode=9", "--leak-check=full")
        assert run(program, name, 3, calls=CALLS // 4, under=under) > 20


@pytest.mark.fuzz
@pytest.mark.slow
@in_fuzz
@pytest.mark.skipif(CLANG is None, reason=f"there is no clang with libFuzzer; {REMEDY}")
@pytest.mark.parametrize("name", CHECKED)
def test_libfuzzer_finds_nothing(tmp_path: Path, name: str) -> None:
    """Sequences of calls and values grow by what reaches new code."""
    flags = ("-g", "-O1", "-DLIBFUZZER", "-fsanitize=fuzzer,address,undefined")
    program = compiled(tmp_path, name, (*flags, "-fno-sanitize-recover=all"), str(CLANG))
    seconds = float(os.environ["CONGELATION_FUZZ_SECONDS"]) / len(CHECKED)
    limits = [f"-max_total_time={max(round(seconds), 1)}", "-max_len=4000", "-timeout=60"]
    done = subprocess.run(
        [program, *limits], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{name}: {done.stderr[-4000:]}"
    (runs,) = re.findall(r"Done (\d+) runs", done.stderr)
    assert int(runs) > 10


@pytest.mark.fuzz
@pytest.mark.slow
@in_fuzz
def test_fresh_seeds(programs: dict[str, Path]) -> None:
    end = time.monotonic() + float(os.environ["CONGELATION_FUZZ_SECONDS"])
    draw = random.SystemRandom()
    steps = 0
    while True:
        name = draw.choice(CHECKED)
        steps += run(programs[name], name, draw.randrange(2**32))
        if time.monotonic() > end:
            break
    assert steps > 0
