"""fmi2DoStep of native FMUs and of their Python twins, and a whole macro step of a native pair.

    python -m benchmarks.native_steps

A loop in C calls both twins in turn, round after round, in one process; a ratio is taken within a
round. The macro step is that of Fig. 2 with held inputs: both FMUs get their inputs, step, and give
their outputs. From C without anything else it is the FMUs' own share; libcosim does it in turn.
"""

from __future__ import annotations

import ctypes
import statistics
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
from fmpy.fmi2 import FMU2Slave
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level

from benchmarks.cases import figure
from benchmarks.engines.libcosim import Libcosim

__all__ = ["main"]

_FMUS = Path(__file__).absolute().parent.parent / "fmus"
_NAMES = ("StrictFeedbackPlant", "StateFeedbackController", "OutputFeedbackController")
_STEP = 1e-4
_ROUNDS, _NATIVE, _PYTHON = 9, 20_000, 500
_LOOP = r"""
#include <stddef.h>
#include <time.h>
typedef int step(void *, double, double, int);
typedef int access(void *, const unsigned *, size_t, double *);

/* One FMU of a loop: its inputs follow from the other one's outputs of the same place. */
struct part {
    void *c;
    step *do_step;
    access *set, *get;
    size_t ins, outs;
    unsigned inputs[8], outputs[8];
    double values[8];
};

/* Processor time of a macro step (Jacobi) in seconds; -1 where a call failed. */
double exchanged(struct part *a, struct part *b, double t, double h, int count)
{
    struct timespec from, to;
    int failed = a->get(a->c, a->outputs, a->outs, a->values);
    failed |= b->get(b->c, b->outputs, b->outs, b->values);
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &from);
    for (int i = 0; i < count; i++) {
        failed |= a->set(a->c, a->inputs, a->ins, b->values);
        failed |= b->set(b->c, b->inputs, b->ins, a->values);
        failed |= a->do_step(a->c, t + i * h, h, 1);
        failed |= b->do_step(b->c, t + i * h, h, 1);
        failed |= a->get(a->c, a->outputs, a->outs, a->values);
        failed |= b->get(b->c, b->outputs, b->outs, b->values);
    }
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &to);
    if (failed) return -1.0;
    return ((double)(to.tv_sec - from.tv_sec) + 1e-9 * (double)(to.tv_nsec - from.tv_nsec)) / count;
}

/* Processor time of a step in seconds; -1 where a step failed. */
double timed(step *do_step, void *c, double t, double h, int count)
{
    struct timespec a, b;
    int failed = 0;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &a);
    for (int i = 0; i < count; i++) failed |= do_step(c, t + i * h, h, 1);
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &b);
    if (failed) return -1.0;
    return ((double)(b.tv_sec - a.tv_sec) + 1e-9 * (double)(b.tv_nsec - a.tv_nsec)) / count;
}
"""


class _Timed:
    """One instance, and the time that it has reached."""

    def __init__(
        self, path: Path, loop: ctypes.CDLL, start: Mapping[str, Any] | None = None
    ) -> None:
        description = fmpy.read_model_description(str(path))
        self.slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(path)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=path.stem,
        )
        self.slave.instantiate()
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        for v in description.modelVariables:
            if v.name in (start or {}):
                set_value = getattr(self.slave, f"set{v.type}")
                set_value([v.valueReference], [(start or {})[v.name]])
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.slave.exitInitializationMode()
        self._timed = loop.timed
        self._timed.restype = ctypes.c_double
        self._step = ctypes.cast(self.slave.dll.fmi2DoStep, ctypes.c_void_p)
        self._time = 0.0

    def steps(self, count: int) -> float:
        """Seconds per step."""
        found: float = self._timed(
            self._step,
            ctypes.c_void_p(self.slave.component),
            ctypes.c_double(self._time),
            ctypes.c_double(_STEP),
            ctypes.c_int(count),
        )
        if found < 0.0:
            raise RuntimeError("a step failed")
        self._time += count * _STEP
        return found


class _Part(ctypes.Structure):
    """`struct part` of the loop."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("c", "do_step", "set", "get")),
        *((name, ctypes.c_size_t) for name in ("ins", "outs")),
        *((name, ctypes.c_uint * 8) for name in ("inputs", "outputs")),
        ("values", ctypes.c_double * 8),
    )


def _macro_steps(loop: ctypes.CDLL) -> Iterator[str]:
    """The rows of the second table."""
    given = figure("fig2").loop
    components = tuple(
        replace(c, fmu=str(_FMUS / "native" / Path(c.fmu).name)) for c in given.components
    )
    timed = [_Timed(Path(c.fmu), loop, c.start) for c in components]
    place = {c.name: i for i, c in enumerate(components)}
    parts = [_Part(c=t.slave.component) for t in timed]
    for part, t in zip(parts, timed, strict=True):
        for name, function in (("do_step", "DoStep"), ("set", "SetReal"), ("get", "GetReal")):
            address = ctypes.cast(getattr(t.slave.dll, f"fmi2{function}"), ctypes.c_void_p)
            setattr(part, name, address.value)
    for a, output, b, input_ in given.connections:
        source, target = place[a], place[b]
        parts[source].outputs[parts[source].outs] = timed[source].references[output]
        parts[target].inputs[parts[target].ins] = timed[target].references[input_]
        parts[source].outs += 1
        parts[target].ins += 1
    loop.exchanged.restype = ctypes.c_double
    log_output_level(CosimLogLevel.WARNING)
    engine = Libcosim(replace(given, components=components))
    own: list[float] = []
    theirs: list[float] = []
    for k in range(_ROUNDS):
        time = ctypes.c_double(k * _NATIVE * _STEP)
        seconds = loop.exchanged(
            *map(ctypes.byref, parts), time, ctypes.c_double(_STEP), ctypes.c_int(_NATIVE)
        )
        if seconds < 0.0:
            raise RuntimeError("a call failed")
        own.append(seconds)
        theirs.append(engine.run(_NATIVE, _STEP, keep_rows=False).seconds / _NATIVE)
    for name, column in (("the FMUs' own share", own), ("libcosim", theirs)):
        low, middle, high = (1e6 * f(column) for f in (min, statistics.median, max))
        yield f"| {name} | {middle:.2f} ({low:.2f} to {high:.2f}) |"


def main() -> None:
    """Print two tables in Markdown."""
    with tempfile.TemporaryDirectory() as temporary:
        source, library = Path(temporary, "loop.c"), Path(temporary, "loop.so")
        source.write_text(_LOOP, "utf-8")
        command = ["gcc", "-O2", "-shared", "-fPIC", str(source), "-o", str(library)]
        subprocess.run(command, check=True)
        loop = ctypes.CDLL(str(library))
        print("| fmi2DoStep of 1e-4 s | Python, us | native, us | ratio (least to most) |")
        print("| --- | --- | --- | --- |")
        for name in _NAMES:
            python = _Timed(_FMUS / f"{name}.fmu", loop)
            native = _Timed(_FMUS / "native" / f"{name}.fmu", loop)
            rounds = [(python.steps(_PYTHON), native.steps(_NATIVE)) for _ in range(_ROUNDS)]
            ratios = sorted(a / b for a, b in rounds)
            slow, fast = (1e6 * statistics.median(column) for column in zip(*rounds, strict=True))
            print(
                f"| {name} | {slow:.2f} | {fast:.3f} | {statistics.median(ratios):.0f} "
                f"({ratios[0]:.0f} to {ratios[-1]:.0f}) |"
            )
        print("\n| Fig. 2, Controller 1, h = 1e-4 s | us per macro step |\n| --- | --- |")
        for row in _macro_steps(loop):
            print(row)


if __name__ == "__main__":
    main()
