"""The tables of the sweeps."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from benchmarks.markdown import Row, duration, spread, table, verdict
from benchmarks.phases import STEPPING
from benchmarks.sweep_job import FRESH, Cost
from benchmarks.sweeps import Fresh, Many, Overhead, Scaling
from benchmarks.timing import median_ratio

__all__ = ["fresh_table", "many_table", "overhead_table", "scaling_table"]

TWO_WORKERS_GOAL = 1.8
OVERHEAD_GOAL = 0.1
FRESH_GOAL = 5.0
MEMORY_GOAL = 1.1
"""Memory after all runs over that after the first thousand."""


def scaling_table(found: Scaling) -> list[str]:
    """One worker and two."""
    counts = (1, 2)
    elapsed = median_ratio(*map(found.elapsed, counts))
    path = median_ratio(*map(found.path, counts))
    goal = f"{TWO_WORKERS_GOAL:g}: {verdict(elapsed >= TWO_WORKERS_GOAL)}"
    ratios = {1: ("1.00", "1.00", ""), 2: (f"{elapsed:.2f}", f"{path:.2f}", goal)}
    rows: list[Row] = [
        (
            "1 worker" if count == 1 else f"{count} workers",
            spread(found.elapsed(count)),
            _used(found.costs(count)),
            _others(found.costs(count)),
            spread(found.path(count)),
            *(ratios[count][k] for k in (1, 0, 2)),
        )
        for count in counts
    ]
    head = (
        f"{found.runs} runs on",
        "elapsed",
        "processors used",
        "processors used by others",
        "processor time of parent and one worker",
        "by it, times as fast",
        "by the clock",
        "goal",
    )
    return table(head, rows)


def overhead_table(found: Sequence[Overhead]) -> list[str]:
    """Where the time of a sweep on one worker goes, side by side."""
    head = ["", *(f"{one.title}: each run" for one in found), *(f"{o.title}: %" for o in found)]
    phases = [name for name in found[0].per_run if name != STEPPING]
    rows: list[Row] = [
        (
            name,
            *(spread(one.per_run[name]) for one in found),
            *(_percent(sum(one.per_run[name].values) / one.cost.elapsed) for one in found),
        )
        for name in (STEPPING, *phases)
    ]
    rows += [
        (
            f"once: {name}",
            *(duration(one.once[name]) for one in found),
            *(_percent(one.once[name] / one.cost.elapsed) for one in found),
        )
        for name in found[0].once
    ]
    rows.append(
        (
            "all but the stepping loop, with recording",
            *(f"of {one.runs} runs in {duration(one.cost.elapsed)}" for one in found),
            *(_percent(one.share) for one in found),
        )
    )
    goal = verdict(found[0].share <= OVERHEAD_GOAL)
    text = f"Goal: {_percent(OVERHEAD_GOAL)} of {found[0].title} at most: {goal}."
    return [*table(head, rows), "", text]


def many_table(found: Many) -> list[str]:
    """Many short runs."""
    answer = found.cost.answer
    rows: list[Row] = [
        (
            f"after {mark['runs']:,} runs",
            f"{mark['parent'] / 1e6:.0f} MB",
            f"{mark['worker'] / 1e6:.0f} MB",
        )
        for mark in answer["memory"]
    ]
    first, last = answer["memory"][0], answer["memory"][-1]
    growth = max(last[one] / first[one] for one in ("parent", "worker"))
    runs = answer["runs"]
    rate = runs / answer["sweep"]
    lines = table(("resident memory", "parent", "largest worker so far"), rows)
    reading = "; ".join(
        f"`{command}` {duration(cost.seconds)}" for command, cost in found.readers.items()
    )
    return [
        *lines,
        "",
        f"Goal: grows by at most {_percent(MEMORY_GOAL - 1.0)} after the first: "
        f"{verdict(growth <= MEMORY_GOAL)}. {answer['workers']} worker processes, two at a time.",
        "",
        f"{runs:,} runs on two workers: {rate:.0f} runs per second, "
        f"{found.cost.used / runs * 1e3:.1f} ms of processor time each; planning all of them "
        f"{duration(answer['planning'])}; writing runs.parquet from the parts, every time "
        f"together, {duration(answer['index'])}; {_others((found.cost,))} processors were busy "
        f"with other work. Reading them all: {reading}.",
    ]


def fresh_table(found: Sequence[Fresh]) -> list[str]:
    """Held inputs: fresh FMPy instances against sweeps."""
    names = list(found[0].times)
    head = (
        "macro steps per run",
        "runs",
        *(f"{name}, per run" for name in names),
        *(f"{FRESH} ÷ {name}" for name in names[1:]),
        "goal",
    )
    rows: list[Row] = []
    for one in found:
        ratios = [median_ratio(one.times[FRESH], one.times[name]) for name in names[1:]]
        rows.append(
            (
                f"{one.steps:,}",
                str(one.runs),
                *(spread(one.times[name].per(one.runs)) for name in names),
                *(f"{ratio:.2f}" for ratio in ratios),
                f"{FRESH_GOAL:g}: {verdict(ratios[0] >= FRESH_GOAL)}",
            )
        )
    return table(head, rows)


def _used(costs: Sequence[Cost]) -> str:
    return f"{statistics.median(cost.used / cost.elapsed for cost in costs):.2f}"


def _others(costs: Sequence[Cost]) -> str:
    """Processors busy with other work meanwhile."""
    shares = [cost.others / cost.elapsed for cost in costs if cost.others is not None]
    return f"{statistics.median(shares):.2f}" if shares else "an unknown number of"


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"
