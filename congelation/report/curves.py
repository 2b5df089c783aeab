"""The curves of trajectories: a panel for each group of recorded variables, down-sampled."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from congelation.results.record import STRETCHES, Trajectory, thin
from congelation.scenario.metrics import norm

__all__ = [
    "ERROR",
    "EVERY",
    "PICKED",
    "POINTS",
    "RATES",
    "RATE_NAMES",
    "STEPS",
    "Curve",
    "Panel",
    "curve_panels",
    "panel_groups",
    "pretty",
]

Array = npt.NDArray[np.float64]

EVERY = -1
"""Stands for a variant's number where a curve is the same in all variants."""

PICKED = -2
"""In place of a variant's number: a curve of the run that a reader has picked."""

DASHES: tuple[tuple[int, ...], ...] = ((), (8, 3), (2, 3), (10, 3, 2, 3), (5, 2), (14, 4))
STEPS = "communication step"
"""Title of the panel of step sizes."""

POINTS = 2000  # of a curve; a screen has no more columns
ERROR = re.compile(r"^error\((?P<of>.+)\)$")
_GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "epsilon": "ε", "eta": "η",
    "theta": "θ", "lambda": "λ", "rho": "ρ", "omega": "ω", "xi": "ξ", "Gamma": "Γ",
}  # fmt: skip
# The order of the paper's figures; other variables follow as they were recorded.
_FIRST = ("x", "y", "u", "theta", "theta_hat", "rho_hat", "z", "V")
# The Lyapunov function and its bound are compared in one panel.
_BOUND = re.compile(r"(?i)(^|\.)(V|V_bound|bound|V_max|bound\(V\))$")
# What runs with a certificate record: V' under the worst theta, and what it may be.
RATE_NAMES = {"certificate.rate": "V' at worst", "certificate.bound": "allowed"}
RATES = "V' and what the certificate allows"


@dataclass(frozen=True)
class Curve:
    """A variable of one run: `time` and `value` as drawn, `numbers` of all that is stored."""

    label: str
    variant: int
    dash: tuple[int, ...]
    unit: str
    time: Array
    value: Array
    numbers: tuple[float, float, float, float] = field(default=(math.nan,) * 4)
    """At the start, least, largest, at the end."""
    name: str = ""
    others: tuple[int, ...] = ()
    """Numbers of further variants, not of all, that have the same curve."""


@dataclass(frozen=True)
class Panel:
    """A plot: its heading, its curves, and how its axis begins."""

    name: str
    title: str
    curves: tuple[Curve, ...]
    note: str = ""

    @property
    def unit(self) -> str:
        units = {curve.unit for curve in self.curves}
        return units.pop() if len(units) == 1 else ""


def panel_groups(columns: Sequence[str], extra: Sequence[str] = ()) -> dict[str, tuple[str, ...]]:
    """Panels by title, and the columns that each shows.

    Elements of a vector share a panel; so do the Lyapunov function and its bound, and all
    estimated errors. `extra` names further panels, ``|plant.x|`` for the norm of a group.
    """
    groups: dict[str, list[str]] = {}
    for column in columns:
        base = column.partition("[")[0]
        if ERROR.match(column):
            title = "estimated error"
        elif column in RATE_NAMES:
            title = RATES
        elif _BOUND.search(base):
            title = "Lyapunov function V"
        else:
            title = base
        groups.setdefault(title, []).append(column)

    def place(title: str) -> tuple[int, int]:
        symbol = title.rpartition(".")[2]
        late = title in ("estimated error", "Lyapunov function V", RATES)
        known = _FIRST.index(symbol) if symbol in _FIRST else len(_FIRST)
        return (2 if late else 0, known)

    found = {title: tuple(groups[title]) for title in sorted(groups, key=place)}
    for panel in extra:
        inner = panel.strip("|")
        if panel.startswith("|") and inner in found:
            found[panel] = found[inner]
    return found


def curve_panels(
    runs: Sequence[tuple[int, Trajectory]],
    extra: Sequence[str] = (),
    points: int = POINTS,
) -> tuple[Panel, ...]:
    """The panels of some runs, each given with the number of its variant.

    A curve has `points` points at most, and two more.
    """
    columns = dict.fromkeys(column for _, run in runs for column in run.columns)
    groups = panel_groups(tuple(columns), extra)
    if any(run.steps is not None for _, run in runs):
        groups[STEPS] = ()
    panels = []
    for k, (title, members) in enumerate(groups.items()):
        found = [*_curves(runs, title, members, points)]
        named = tuple(replace(curve, name=f"c{k}.{i}") for i, curve in enumerate(found))
        if named:
            panels.append(Panel(f"p{k}", title, named, _note(title, [run for _, run in runs])))
    return tuple(panels)


def _note(title: str, runs: Sequence[Trajectory]) -> str:
    """What there is to say of a panel."""
    steps = [run.steps for run in runs if run.steps is not None]
    if title != STEPS or all(found.count == len(found.time) for found in steps):
        return ""
    most = max(found.count for found in steps)
    return (
        f"Each step at its end. Of up to {most} steps, the shortest and the longest of each of "
        f"{STRETCHES} stretches were kept, and of equal steps the first and the last."
    )


def _curves(
    runs: Sequence[tuple[int, Trajectory]], title: str, members: Sequence[str], points: int
) -> Iterator[Curve]:
    if title == STEPS:
        for variant, run in runs:
            if run.steps is not None and len(run.steps.time):
                yield _curve("step", variant, (), "s", run.steps.time, run.steps.length, points)
        return
    if title.startswith("|"):
        for variant, run in runs:
            own = [column for column in members if column in run.columns]
            units = {run.units.get(column, "") for column in own}
            unit = units.pop() if len(units) == 1 else ""
            if own and len(run.time):
                yield _curve(title, variant, (), unit, run.time, norm(run.select(own)), points)
        return
    for k, column in enumerate(members):
        dash = DASHES[k % len(DASHES)]
        held = [(v, run) for v, run in runs if column in run.columns and len(run.time)]
        for same in _alike(held, column):
            # Of runs with the same curve, e.g. theta(t), the one that went furthest is drawn, and
            # of these the one with most rows.
            run = max((run for _, run in same), key=lambda run: (run.time[-1], len(run.time)))
            first, *others = (v for v, _ in same)
            variant = EVERY if others and len(same) == len(held) else first
            shown = run.select((column,))[:, 0]
            curve = _curve(
                column, variant, dash, run.units.get(column, ""), run.time, shown, points
            )
            yield replace(curve, others=tuple(others) if variant != EVERY else ())


def _alike(
    runs: Sequence[tuple[int, Trajectory]], column: str
) -> list[list[tuple[int, Trajectory]]]:
    """The runs in groups that have the same curve of a column: of the same profile and FMU, or
    with equal rows as far as both go."""
    groups: list[list[tuple[int, Trajectory]]] = []
    for variant, run in runs:
        for group in groups:
            other = group[0][1]
            given, count = other.signals.get(column), min(len(run.time), len(other.time))
            if (given is not None and given == run.signals.get(column)) or (
                np.array_equal(run.time[:count], other.time[:count])
                and np.array_equal(run.select((column,))[:count], other.select((column,))[:count])
            ):
                group.append((variant, run))
                break
        else:
            groups.append([(variant, run)])
    return groups


def _curve(
    label: str,
    variant: int,
    dash: tuple[int, ...],
    unit: str,
    time: Array,
    values: Array,
    points: int,
) -> Curve:
    rows = thin(values, points // 2)
    numbers = (math.nan,) * 4
    if np.any(np.isfinite(values)):
        least, largest = float(np.nanmin(values)), float(np.nanmax(values))
        numbers = (float(values[0]), least, largest, float(values[-1]))
    return Curve(label, variant, dash, unit, time[rows], values[rows], numbers)


def pretty(label: str) -> str:
    """A variable's name with Greek letters: ``controller.theta_hat[1]`` has θ̂."""
    found = re.sub(r"(?<![A-Za-z])(" + "|".join(_GREEK) + r")(?![A-Za-z])", _letter, label)
    return re.sub(r"(\w)_hat\b", lambda match: f"{match[1]}\u0302", found)


def _letter(match: re.Match[str]) -> str:
    return _GREEK[match[1]]
