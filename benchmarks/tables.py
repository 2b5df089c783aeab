"""The tables of docs/benchmarks.md."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.accuracy import MINUTE, OURS, SOLVERS, TARGETS, Accuracy, Reached
from benchmarks.engines import ENGINES
from benchmarks.macro_step import BARE, NAIVE, MacroStep
from benchmarks.macro_step import OURS as MASTER
from benchmarks.markdown import Row, duration, microseconds, power, spread, table, verdict
from benchmarks.micro import Micro
from benchmarks.timing import median_ratio

__all__ = ["accuracy_table", "macro_step_table", "micro_table", "solver_table"]

PEER_GOAL = 3.0
NAIVE_GOAL = 6.0
ACCURACY_GOAL = 100_000.0
SOLVER_GOAL = 2.0
GOAL_TARGET = 1e-6

LABELS = {
    MASTER: "congelation, `jacobi`",
    BARE: "bare loop over preallocated buffers",
    NAIVE: "naive pair in a plain FMPy loop",
}


def macro_step_table(found: MacroStep) -> list[str]:
    """Cost per macro step."""
    ours, fmus = found.times[MASTER], found.fmus
    rows: list[Row] = [("the FMUs' own time in it", microseconds(fmus), "", "", "")]
    for name, time in found.times.items():
        goal = ""
        ratio = median_ratio(time, ours)
        if name not in (MASTER, BARE):
            wanted = NAIVE_GOAL if name == NAIVE else PEER_GOAL
            goal = f"{wanted:g}: {verdict(ratio >= wanted)}"
        over = "" if name == NAIVE else f"{(time.median - fmus.median) * 1e6:.1f}"
        rows.append((_label(name), microseconds(time), over, f"{ratio:.2f}", goal))
    head = ("", "µs per macro step", "over the FMUs' own", "÷ congelation", "goal")
    return [*table(head, rows), *_not_run(found.failures)]


def accuracy_table(found: Accuracy) -> list[str]:
    """Time to reach each error, against engines with held inputs."""
    head = (
        "",
        *map(power, TARGETS),
        "order",
        f"÷ congelation at {power(GOAL_TARGET)}",
    )
    ours = [found.reached.get((OURS, target)) for target in TARGETS]
    rows: list[Row] = [("congelation, `hermite`", *map(_reached, ours), "", "1")]
    best = found.reached.get((OURS, GOAL_TARGET))
    ratios = []
    for name, held in found.held.items():
        times = [held.seconds(target) for target in TARGETS]
        ratio = ""
        if best is not None:
            ratios.append(held.seconds(GOAL_TARGET) / best.time.median)
            ratio = _rounded(ratios[-1])
        rows.append((_label(name), *map(_duration, times), f"{held.order:.2f}", ratio))
    lines = [*table(head, rows), *_not_run(found.failures)]
    if ratios:
        goal = f"{ACCURACY_GOAL:,.0f} times the best of them at {power(GOAL_TARGET)}"
        lines += ["", f"Goal: {goal}: {verdict(min(ratios) >= ACCURACY_GOAL)}."]
    return lines


def solver_table(found: Sequence[Accuracy]) -> list[str]:
    """Time to reach each error, against solve_ivp on the same equations without FMUs."""
    head = (
        "",
        *map(power, TARGETS),
        f"congelation ÷ it at {power(GOAL_TARGET)}",
        "goal",
    )
    rows: list[Row] = []
    for figure in found:
        for program in (OURS, *SOLVERS):
            reached = [figure.reached.get((program, target)) for target in TARGETS]
            label = "congelation, `hermite`" if program == OURS else f"`solve_ivp`, {program}"
            ours, other = (figure.reached.get((p, GOAL_TARGET)) for p in (OURS, program))
            ratio = goal = ""
            if program != OURS and ours is not None and other is not None:
                value = median_ratio(ours.time, other.time)
                ratio, goal = f"{value:.1f}", f"{SOLVER_GOAL:g}: {verdict(value <= SOLVER_GOAL)}"
            rows.append((f"{figure.title}: {label}", *map(_reached, reached), ratio, goal))
    return table(head, rows)


def micro_table(found: Sequence[Micro]) -> list[str]:
    """Small measurements."""
    rows = [
        (
            one.what,
            spread(one.time),
            ""
            if one.goal is None
            else f"{duration(one.goal)}: {verdict(one.time.median <= one.goal)}",
        )
        for one in found
    ]
    return table(("", "median (least – most)", "goal"), rows)


def _not_run(failures: Sequence[str]) -> list[str]:
    return ["", *(f"Not run: {failure}." for failure in failures)] if failures else []


def _label(name: str) -> str:
    if name in LABELS:
        return LABELS[name]
    entry = ENGINES[name]
    return f"{entry.label} ({entry.quirk})" if entry.quirk else entry.label


def _reached(found: Reached | None) -> str:
    return "not reached" if found is None else f"{found.time.median:.3g} s"


def _duration(seconds: float) -> str:
    """Marked where it was extrapolated."""
    mark = " ᵉ" if seconds > MINUTE else ""
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return (
                f"{seconds / size:.2g} {unit}{mark}"
                if seconds < 100.0 * size
                else (f"{seconds / size:.0f} {unit}{mark}")
            )
    return f"{seconds:.3g} s{mark}"


def _rounded(value: float) -> str:
    """Two digits, with separators."""
    return f"{float(f'{value:.1e}'):,.0f}"
