"""libcosim's ECCO algorithm: held inputs, steps chosen by the power that connections lose.

S. Sadjina, L. T. Kyllingstad, S. Skjong, E. Pedersen, Energy conservation and power bonds in
co-simulations: non-iterative adaptive step size control and error estimation, Engineering with
Computers 33 (2017) 607.
"""

from __future__ import annotations

from libcosimpy.CosimAlgorithm import CosimAlgorithm, EccoParams
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver

from benchmarks.engines.base import Run
from benchmarks.engines.libcosim import NANOSECONDS, Libcosim
from benchmarks.loop import Loop
from benchmarks.timing import Stopwatch

__all__ = ["Ecco"]

SHORTEST, LONGEST = 3e-5, 1e-2
"""Of the horizon: the steps that it may take."""

STARTED = 1e-4
"""Of the horizon: the first step."""


class Ecco(Libcosim):
    """Every run is an execution of its own."""

    def run(self, *, tolerance: float, stop_time: float, keep_rows: bool) -> Run:  # type: ignore[override]
        """The first step, which initialises, is left out of the time."""
        algorithm = CosimAlgorithm.create_ecco_algorithm(
            EccoParams(
                step_size=STARTED * stop_time,
                min_step_size=SHORTEST * stop_time,
                max_step_size=LONGEST * stop_time,
                # The package's own would have steps shrink for ever.
                min_change_rate=0.2,
                max_change_rate=1.5,
                abs_tolerance=tolerance,
                rel_tolerance=tolerance,
            )
        )
        execution = CosimExecution.from_algorithm(algorithm)
        owned, places = self._added(execution)
        pairs = _bonds(self.loop)
        if not pairs:
            raise RuntimeError("ECCO needs connections in both directions between two parts")
        for a, y, v, b, z, u in pairs:
            references = [
                self._tables[part][name].reference
                for part, name in ((a, y), (a, v), (b, z), (b, u))
            ]
            algorithm.add_power_bond(places[a], *references[:2], places[b], *references[2:])
        self._prepare(execution, places)
        observer = CosimObserver.create_last_value()
        execution.add_observer(observer)
        execution.step(step_count=1)
        rows: list[list[float]] = []
        watch = Stopwatch()
        while execution.status().current_time < stop_time * NANOSECONDS:
            if not execution.step(step_count=1):
                raise RuntimeError("ECCO could not make a step")
            if not keep_rows:
                continue
            rows.append([execution.status().current_time / NANOSECONDS])
            for part, name in self.loop.record:
                reference = self._tables[part][name].reference
                rows[-1] += observer.last_real_values(places[part], [reference])
        seconds = watch.seconds()
        del execution, owned
        return Run(seconds, rows)


def _bonds(loop: Loop) -> list[tuple[str, str, str, str, str, str]]:
    """Pairs of connections between the same two parts, one in each direction: each end as part,
    output, input."""
    found = []
    # From the last one on: speed comes after place, and makes power with a force.
    left = list(reversed(loop.connections))
    while left:
        a, y, b, u = left.pop(0)
        back = next((c for c in left if (c[0], c[2]) == (b, a)), None)
        if back is not None:
            left.remove(back)
            found.append((a, y, back[3], b, back[1], u))
    return found
