"""The compiled stepping loop against the loop in Python, on FMUs in C whose own share is small.

``python -m benchmarks.compiled`` prints a table of processor times per macro step.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.coupling.parts import build
from benchmarks.coupling.problems import problem
from benchmarks.markdown import table
from benchmarks.timing import Stopwatch, interleaved
from congelation.cosim import SlavePool, compiled, simulate

__all__ = ["measure"]

STEPS = 20_000
CASES: Mapping[str, Mapping[str, Any]] = {
    "jacobi": {"coupling": "jacobi", "step": 1e-4, "stop_time": 1e-4 * STEPS},
    "gauss_seidel": {"coupling": "gauss_seidel", "step": 1e-4, "stop_time": 1e-4 * STEPS},
    "hermite at 1e-9": {"coupling": "hermite", "tolerance": 1e-9, "stop_time": 100.0},
}


def measure(folder: Path) -> str:
    """The table, for the oscillator of two masses."""
    build(folder, ("full",))
    system = problem("two_masses_plain").system(folder, "full")
    library = compiled.library.loaded
    found = library()

    def seconds(case: str, in_c: bool) -> float:
        compiled.library.loaded = (lambda: found) if in_c else (lambda: None)  # type: ignore[assignment]
        watch = Stopwatch()
        result = simulate(system, pool=pool, **CASES[case])
        assert result.completed, result.message
        return watch.seconds() / result.statistics.macro_steps

    try:
        with SlavePool() as pool:
            timings = interleaved(
                {
                    (case, in_c): (lambda case=case, in_c=in_c: seconds(case, in_c))
                    for case in CASES
                    for in_c in (True, False)
                },
                5,
            )
    finally:
        compiled.library.loaded = library
    rows = [
        [
            f"`{case}`",
            f"{1e6 * timings[case, True].median:.2f}",
            f"{1e6 * timings[case, False].median:.1f}",
            f"{timings[case, False].median / timings[case, True].median:.0f}",
        ]
        for case in CASES
    ]
    return "\n".join(table(["coupling", "in C, us", "in Python, us", "ratio"], rows))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        print(measure(Path(name)))
