"""Measure error bars and couplings on the coupling problems: ``python -m benchmarks.coupling``.

Tables go to docs/trust.md, docs/cosim.md and docs/work_precision.md, diagrams beside the latter.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from benchmarks.__main__ import Part
from benchmarks.coupling import choice, coverage, work
from benchmarks.coupling.parts import build
from benchmarks.coupling.problems import PROBLEMS, problem
from benchmarks.machine import description

__all__ = ["WORK", "main", "sources"]

DOCS = Path(__file__).absolute().parent.parent.parent / "docs"
WORK = DOCS / "work_precision.md"
DIAGRAMS = DOCS / "work_precision.png"

PAPER = (
    "K. Chen, A. Astolfi, Adaptive control of linear systems with time-varying parameters, "
    "ACC (2018), section V"
)

PROCESSES = 5
"""Error bars are counted, not timed: problems may be measured side by side."""


def main(arguments: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.coupling", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one problem; print, do not write")
    alone = parser.add_mutually_exclusive_group()
    alone.add_argument("--trust", action="store_true", help="only the error bars")
    alone.add_argument("--auto", action="store_true", help="only the coupling that auto chooses")
    alone.add_argument("--work", action="store_true", help="only work and precision")
    given = parser.parse_args(arguments)
    command = " ".join(["python -m benchmarks.coupling", *(arguments or sys.argv[1:])])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        build(folder)
        if not given.work and not given.auto:
            for lines in _bars(folder, quick=given.quick):
                text = "\n".join([*description(command), "", *lines])
                _written(DOCS / "trust.md", "error bars", text, quick=given.quick)
        if not given.work and not given.trust:
            for lines in _choices(folder, quick=given.quick):
                text = "\n".join([*description(command), "", *lines])
                _written(DOCS / "cosim.md", "auto", text, quick=given.quick)
        if not given.trust and not given.auto:
            _written(WORK, "sources", "\n".join(sources()), quick=given.quick)
            for lines in _work(folder, quick=given.quick):
                text = "\n".join([*description(command), "", *lines])
                _written(WORK, "work and precision", text, quick=given.quick)
    return 0


def sources() -> list[str]:
    """Where the problems are from, as a table in Markdown."""
    found = [(p.title, p.source) for p in PROBLEMS]
    found += [(title, PAPER) for title in work.FIGURES.values()]
    return [
        "| problem | source |",
        "|---|---|",
        *(f"| {title} | {source} |" for title, source in found),
    ]


def _bars(folder: Path, *, quick: bool) -> Iterator[list[str]]:
    """The lines of the page after each problem: a run that is broken off leaves what it has."""
    pairs: list[coverage.Pair] = []
    ended: list[str] = []
    problems = PROBLEMS[-1:] if quick else PROBLEMS
    with ProcessPoolExecutor(PROCESSES, multiprocessing.get_context("spawn")) as pool:
        # The new ones first: what is broken off has some of both.
        order = sorted(problems, key=lambda problem: problem.known)
        waiting = {pool.submit(coverage.measure, folder, problem): problem for problem in order}
        for done in as_completed(waiting):
            found, without = done.result()
            _say(f"error bars, {waiting[done].title}: {len(found)} pairs")
            for pair in found:
                if not pair.is_good:
                    print(pair, file=sys.stderr, flush=True)
            pairs += found
            ended += without
            # In the order of the problems, whichever came first.
            pairs.sort(key=lambda pair: PROBLEMS.index(pair.setting.problem))
            lines = [*coverage.goals(pairs), "", *coverage.per_problem(pairs)]
            if ended:
                lines += ["", "Without bars:", "", *(f"- {line}" for line in sorted(ended))]
            yield lines


def _choices(folder: Path, *, quick: bool) -> Iterator[list[str]]:
    """The lines of the page after each problem: a run that is broken off leaves what it has."""
    chosen: list[choice.Chosen] = []
    problems = PROBLEMS[-1:] if quick else PROBLEMS
    with ProcessPoolExecutor(PROCESSES, multiprocessing.get_context("spawn")) as pool:
        waiting = {pool.submit(choice.measure, folder, problem): problem for problem in problems}
        for done in as_completed(waiting):
            _say(f"auto, {waiting[done].title}")
            chosen += done.result()
            chosen.sort(key=lambda each: [p.name for p in PROBLEMS].index(each.problem.name))
            yield choice.table(chosen)


def _work(folder: Path, *, quick: bool) -> Iterator[list[str]]:
    """The lines of the page after each case: a run that is broken off leaves what it has."""
    points: list[work.Point] = []
    failures: list[str] = []
    cases = [work.of_problem(problem(work.SHOWN[0]), folder)] if quick else work.shown(folder)
    for case in cases:
        _say(f"work and precision, {case.title}")
        found, failed = work.measure(case)
        points += found
        failures += failed
        if not quick:
            work.draw(points, DIAGRAMS)
        notes = ["", "What did not run:", "", *(f"- {line}" for line in failures)]
        yield [*work.table(points), *(notes if failures else [])]


def _written(page: Path, name: str, text: str, *, quick: bool) -> None:
    print(text)
    if not quick:
        page.write_text(Part(name, lambda _: []).replaced(page.read_text("utf-8"), text), "utf-8")


def _say(what: str) -> None:
    print(f"measuring {what} ..", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
