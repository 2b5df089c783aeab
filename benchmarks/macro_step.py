"""Cost per macro step with held inputs: every engine on the same two FMUs, and a naive pair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from benchmarks.cases import figure
from benchmarks.loop import Loop
from benchmarks.naive.build import naive_loop
from benchmarks.timing import Timing, interleaved
from benchmarks.workers import workers

__all__ = ["BARE", "NAIVE", "OURS", "STEP", "MacroStep", "measure"]

OURS = "ours"
BARE = "bare"
NAIVE = "naive"
HOLLOW = "hollow"

BUILD = Path(__file__).absolute().parent.parent / "build" / "naive"

STEP = 1e-4
"""Communication step in seconds, that of scenarios/fig2.toml."""


@dataclass(frozen=True)
class MacroStep:
    """Seconds per macro step.

    Parameters
    ----------
    times : mapping of str to Timing
        By the engine's name; NAIVE is the naive pair under FMPy's loop.
    fmus : Timing
        Of this, what the FMUs themselves take: the bare loop without the host's part.
    failures : tuple of str
        Engines that did not run, and why.
    """

    times: Mapping[str, Timing]
    fmus: Timing
    failures: tuple[str, ...]


def measure(engines: tuple[str, ...], steps: int, rounds: int) -> MacroStep:
    """Time `engines` on Fig. 2, and FMPy's loop on the naive pair.

    Parameters
    ----------
    engines : tuple of str
        Others than OURS and BARE, by their names in ENGINES.
    steps, rounds : int
        Macro steps of one run, and runs of each engine.
    """
    ours = _coupled_only(figure("fig2").loop)
    loops = {engine: (engine, ours) for engine in (OURS, BARE, HOLLOW, *engines)}
    loops[NAIVE] = ("fmpy_loop", naive_loop(BUILD))
    with workers(loops) as (running, failures):
        times = interleaved(
            {n: partial(worker.seconds, steps=steps, step=STEP) for n, worker in running.items()},
            rounds,
        )
    per_step = {name: t.per(steps) for name, t in times.items()}
    hollow = per_step.pop(HOLLOW)
    pairs = zip(per_step[BARE].values, hollow.values, strict=True)
    return MacroStep(per_step, Timing(tuple(a - b for a, b in pairs)), tuple(failures))


def _coupled_only(loop: Loop) -> Loop:
    """Only what is exchanged is recorded: some engines pay for each further variable."""
    connected = dict.fromkeys((source, name) for source, name, _, _ in loop.connections)
    return replace(loop, record=tuple(connected))
