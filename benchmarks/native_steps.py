"""fmi2DoStep of native FMUs and of their Python twins, called from C.

    python -m benchmarks.native_steps

A loop in C calls both in turn, round after round, in one process; a ratio is taken within a round.
"""

from __future__ import annotations

import ctypes
import statistics
import subprocess
import tempfile
from pathlib import Path

import fmpy
from fmpy.fmi2 import FMU2Slave

__all__ = ["main"]

_FMUS = Path(__file__).absolute().parent.parent / "fmus"
_NAMES = ("StrictFeedbackPlant", "StateFeedbackController", "OutputFeedbackController")
_STEP = 1e-4
_ROUNDS, _NATIVE, _PYTHON = 9, 20_000, 500
_LOOP = r"""
#include <time.h>
typedef int step(void *, double, double, int);

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

    def __init__(self, path: Path, loop: ctypes.CDLL) -> None:
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


def main() -> None:
    """Print a table in Markdown."""
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


if __name__ == "__main__":
    main()
