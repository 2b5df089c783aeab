"""Run the benchmarks and write their tables into docs/benchmarks.md."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from benchmarks import accuracy, long_run, macro_step, micro, sweeps
from benchmarks.engines import ENGINES
from benchmarks.machine import description
from benchmarks.sweep_tables import fresh_table, many_table, overhead_table, scaling_table
from benchmarks.tables import accuracy_table, macro_step_table, micro_table, solver_table

__all__ = ["FULL", "PAGE", "QUICK", "Effort", "Part", "Sweeps", "main"]

PAGE = Path(__file__).absolute().parent.parent / "docs" / "benchmarks.md"


@dataclass(frozen=True)
class Sweeps:
    """How long to measure sweeps; each point is two runs.

    Parameters
    ----------
    rounds : int
    points : int
        Of the sweep on one worker and on two.
    stop_time : float
        Of these runs and those whose time is looked into, in seconds.
    cheap, dear : int
        Points of the sweeps whose time is looked into: chosen steps, and as shipped.
    many : int
        Points of the many short runs.
    short : float
        Their stop time, in seconds.
    marks : tuple of int
        Memory is printed after so many of them.
    held : tuple of (int, int)
        Macro steps and points of the sweeps against fresh FMPy instances.
    """

    rounds: int = 3
    points: int = 100
    stop_time: float = 10.0
    cheap: int = 40
    dear: int = 3
    many: int = 5000
    short: float = 1e-3
    marks: tuple[int, ...] = (1000, 5000, 10000)
    held: tuple[tuple[int, int], ...] = ((10, 400), (100, 200), (1000, 20), (10000, 2))


@dataclass(frozen=True)
class Effort:
    """How long to measure.

    Parameters
    ----------
    engines : tuple of str
        By their names in ENGINES.
    figures : tuple of (str, str)
        Scenario and title.
    rounds : int
        Repetitions of everything that is quick.
    macro_steps : int
        Of one run, for the cost per macro step.
    stop_time : float or None
        Of the figures, in seconds; None: their scenarios' own.
    finest : float
        Smallest communication step with held inputs, in seconds.
    tolerances : tuple of float
    orders : (int, int)
        n and p of the law that is derived.
    sweeps : Sweeps
    long_run : (int, int)
        Macro steps, and every how many of them a row is recorded.
    """

    engines: tuple[str, ...] = tuple(ENGINES)
    figures: tuple[tuple[str, str], ...] = (("fig2", "Fig. 2"), ("fig3", "Fig. 3"))
    rounds: int = 9
    macro_steps: int = 2000
    stop_time: float | None = None
    finest: float = 1e-4
    tolerances: tuple[float, ...] = tuple(10.0 ** (-k / 2.0) for k in range(4, 23))
    orders: tuple[int, int] = (4, 4)
    sweeps: Sweeps = field(default_factory=Sweeps)
    long_run: tuple[int, int] = (10_000_000, 10)


FULL = Effort()
QUICK = Effort(
    engines=("fmpy_loop",),
    figures=(("fig2", "Fig. 2"),),
    rounds=1,
    macro_steps=50,
    stop_time=0.1,
    finest=5e-4,
    tolerances=(1e-4, 1e-6),
    orders=(2, 2),
    sweeps=Sweeps(
        rounds=1,
        points=1,
        stop_time=0.01,
        cheap=1,
        dear=1,
        many=10,
        marks=(10, 20),
        held=((10, 1),),
    ),
    long_run=(1000, 10),
)
"""Shows that everything runs; its numbers mean nothing."""


def sections(effort: Effort) -> list[str]:
    """Measure, and return the lines of the page between its markers, the machine's left out."""
    _say("cost per macro step")
    lines = ["### Cost per macro step with held inputs", ""]
    steps = macro_step.measure(effort.engines, effort.macro_steps, effort.rounds)
    lines += macro_step_table(steps)
    figures = []
    for name, title in effort.figures:
        _say(f"time to accuracy, {title}")
        found = accuracy.measure(
            name,
            title,
            effort.engines,
            stop_time=effort.stop_time,
            finest=effort.finest,
            tolerances=effort.tolerances,
            rounds=min(effort.rounds, 5),
        )
        figures.append(found)
        lines += ["", f"### Time to accuracy, {title}, Controller 1", "", *accuracy_table(found)]
    lines += ["", "### Against no FMUs at all", "", *solver_table(figures)]
    _say("small measurements")
    small = micro.measure(effort.rounds, effort.orders)
    lines += ["", "### Small measurements", "", *micro_table(small)]
    return lines


def sweep_sections(whole: Effort) -> list[str]:
    """The same for sweeps."""
    effort = whole.sweeps
    _say("one worker and two")
    one_two = sweeps.scaling(effort.points, effort.stop_time, effort.rounds)
    _say("where the time of sweeps goes")
    overheads = [
        sweeps.overhead("Fig. 2", effort.dear, {"stop_time": effort.stop_time}),
        sweeps.overhead(
            "chosen steps", effort.cheap, {**sweeps.CHEAP, "stop_time": effort.stop_time}
        ),
    ]
    _say("many short runs")
    short = sweeps.many(effort.many, effort.short, effort.marks)
    _say("sweeps against fresh FMPy instances")
    held = [sweeps.fresh(steps, points, effort.rounds) for steps, points in effort.held]
    lines = ["### A sweep on two workers", "", *scaling_table(one_two)]
    lines += ["", "### Outside the stepping loop", "", *overhead_table(overheads)]
    lines += ["", "### Many short runs", "", *many_table(short)]
    return [*lines, "", "### Against fresh FMPy instances", "", *fresh_table(held)]


def long_section(effort: Effort) -> list[str]:
    """The same for the long run."""
    steps, every = effort.long_run
    _say(f"a run of {steps:,} macro steps")
    return long_run.long_run_table(long_run.measure(steps, every))


@dataclass(frozen=True)
class Part:
    """A part of the page, between markers of its own.

    Parameters
    ----------
    name : str
        In the markers.
    lines : callable
        Measures.
    """

    name: str
    lines: Callable[[Effort], list[str]]

    def replaced(self, page: str, text: str) -> str:
        """The page with `text` between the markers.

        Raises
        ------
        ValueError
            If they are not there.
        """
        begin, end = f"<!-- begin {self.name} -->", f"<!-- end {self.name} -->"
        head, is_begun, rest = page.partition(begin)
        _, is_ended, tail = rest.partition(end)
        if not (is_begun and is_ended):
            raise ValueError(f"{PAGE} has no markers {begin} and {end}")
        return f"{head}{begin}\n\n{text}\n\n{end}{tail}"


ENGINE_PART = Part("engines", sections)
SWEEP_PART = Part("sweeps", sweep_sections)
LONG_PART = Part("long run", long_section)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command ``python -m benchmarks``."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="only show that everything runs; print, do not write"
    )
    parser.add_argument(
        "--without",
        action="append",
        default=[],
        choices=sorted(ENGINES),
        help="leave an engine out",
    )
    alone = parser.add_mutually_exclusive_group()
    alone.add_argument("--sweeps", action="store_true", help="only what is about sweeps")
    alone.add_argument(
        "--long", action="store_true", help="only the run of ten million steps; it takes minutes"
    )
    given = parser.parse_args(arguments)
    effort = QUICK if given.quick else FULL
    engines = tuple(name for name in effort.engines if name not in given.without)
    command = " ".join(["python -m benchmarks", *(arguments or sys.argv[1:])])
    effort = replace(effort, engines=engines)
    for part in _parts(sweeps=given.sweeps, long=given.long):
        text = "\n".join([*description(command), "", *part.lines(effort)])
        print(text)
        if not given.quick:
            PAGE.write_text(part.replaced(PAGE.read_text("utf-8"), text), "utf-8")
    return 0


def _parts(*, sweeps: bool, long: bool) -> tuple[Part, ...]:
    if long:
        return (LONG_PART,)
    return (SWEEP_PART,) if sweeps else (ENGINE_PART, SWEEP_PART)


def _say(what: str) -> None:
    print(f"measuring {what} ..", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
