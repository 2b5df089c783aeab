"""Running an FMU in a host that is not Python: a small C program, compiled on the spot."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sysconfig
from collections.abc import Iterator, Sequence
from importlib.resources import as_file, files
from pathlib import Path

from congelation.conformance.accepted import is_pythonfmu
from congelation.conformance.bench import Bench
from congelation.conformance.rule import NotApplicable, Violated
from congelation.conformance.trajectory import demand, same

__all__ = ["compile_host", "ending", "loads_bare", "python_library", "run_in_host"]

_COMPILERS = ("cc", "gcc", "clang")


def compile_host(folder: Path) -> Path:
    """Compile the C host into a folder, once.

    Raises
    ------
    NotApplicable
        There is no C compiler.
    """
    program = folder / "host"
    if program.exists():
        return program
    wanted = os.environ.get("CC", "")
    compiler = next((c for c in (wanted, *_COMPILERS) if c and shutil.which(c)), None)
    if compiler is None:
        raise NotApplicable("no C compiler (cc, gcc, clang, or $CC) to build the host with")
    with (
        as_file(files("congelation.conformance") / "host.c") as source,
        as_file(files("fmpy") / "c-code") as headers,
    ):
        subprocess.run(
            [
                *(compiler, "-O1", f"-I{headers}", "-o", program, source),
                # FMUs may leave the functions of libm to their host.
                *("-Wl,--no-as-needed", "-ldl", "-lm"),
            ],
            check=True,
        )
    return program


def python_library() -> Path:
    """The shared libpython of this interpreter, which FMUs written in Python need in a C host.

    Raises
    ------
    NotApplicable
        This Python has none.
    """
    folder, name = sysconfig.get_config_vars("LIBDIR", "INSTSONAME")
    path = Path(folder or "", name or "")
    if not path.is_file() or ".so" not in path.name:
        raise NotApplicable("this Python has no shared libpython to preload in the host")
    return path


def ending(code: int) -> str:
    """How a process ended, in words."""
    if code < 0:
        return f"was killed by {signal.Signals(-code).name}"
    return f"ended with exit code {code}"


def run_in_host(bench: Bench) -> Iterator[str]:
    """Run in the C host with the start values, and compare the Real outputs to the last bit."""
    outputs = [
        v for v in bench.description.variables if v.causality == "output" and v.element == "Real"
    ]
    references = [v.reference for v in outputs]
    results = Path(bench.job.scratch) / "rows"
    more = [str(bench.grid.steps), str(results), *(str(r) for r in references)]
    done = _host(bench, "run", more)
    if done.returncode != 0:
        said = done.stderr.strip()[-300:]
        raise Violated(f"the C host {ending(done.returncode)}: {said or 'no message'}")
    rows = [
        [float.fromhex(word) for word in line.split()] for line in results.read_text().splitlines()
    ]
    for point, (row, expected) in enumerate(zip(rows, _rows(bench, references), strict=True)):
        for v, value, wanted in zip(outputs, row, expected, strict=True):
            if not same(value, wanted):
                yield f"in the C host {v.name} is {value!r} instead of {wanted!r} at row {point}"
                return


def _rows(bench: Bench, references: Sequence[int]) -> Iterator[list[float]]:
    """The same run in this process: no input is set."""
    grid, instance = bench.grid, bench.fresh()
    demand(instance.setup(grid.start), "fmi2SetupExperiment")
    demand(instance.enter(), "fmi2EnterInitializationMode")
    demand(instance.leave(), "fmi2ExitInitializationMode")
    for point in range(grid.steps):
        demand(instance.step(grid.start + point * grid.step, grid.step), "fmi2DoStep")
        status, values = instance.get("Real", references)
        demand(status, "fmi2GetReal of the outputs")
        yield [float(value) for value in values]
    instance.free()


def loads_bare(bench: Bench) -> str | None:
    """Whether a host without anything preloaded can load the library; None, or why not."""
    done = _host(bench, "load", [], preload=False)
    if done.returncode == 0:
        return None
    return f"the C host {ending(done.returncode)} on loading: {done.stderr.strip()[-200:]}"


def _host(
    bench: Bench, task: str, more: Sequence[str], *, preload: bool = True
) -> subprocess.CompletedProcess[str]:
    program = compile_host(Path(bench.job.scratch))
    environment = {k: v for k, v in os.environ.items() if k not in ("LD_PRELOAD", "PYTHONPATH")}
    if preload and is_pythonfmu(bench.directory):
        environment["LD_PRELOAD"] = str(python_library())
    grid = bench.grid
    words = [
        str(program),
        task,
        str(bench.binary),
        bench.description.guid,
        bench.uri,
        repr(grid.start),
        repr(grid.step),
    ]
    return subprocess.run(
        [*words, *more],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        check=False,
    )
