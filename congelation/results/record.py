"""The record of a run, its trajectory, and a study: what is stored and read back."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, final

import numpy as np
import numpy.typing as npt

from congelation.cosim.result import Status

__all__ = [
    "COLUMNS",
    "GROUPS",
    "STRETCHES",
    "Outcome",
    "RunRecord",
    "Steps",
    "Study",
    "Trajectory",
    "thin",
]

Array = npt.NDArray[np.float64]

Scalar = bool | int | float | str

GROUPS: Mapping[str, str] = {
    "settings": "set.",
    "metrics": "metric.",
    "deviations": "deviation.",
    "fmus": "fmu.",
}
"""Fields of a record that hold several values, and what the names of their columns begin with."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended: the part of its record that its worker knows.

    Parameters
    ----------
    status : str
        COMPLETED, or how the run ended otherwise.
    message : str
        One line.
    cause : str, optional
        What ended the worker process: ``SIGSEGV``, ``exit code 3``, ``time limit``.
    metrics : mapping
        None unless the run reached its stop time.
    deviations : mapping
        Of a verified run: the largest error of each variable against the monolithic solution,
        relative to the variable's peak.
    steps, rejected_steps, iterations : int, optional
        Communication steps accepted and rejected, passes over all components.
    estimated_error : float, optional
        As in `congelation.cosim.result.Statistics`.
    wall_time : float, optional
        Seconds.
    warnings : int, optional
        Messages of status fmi2Warning that the FMUs logged.
    worst_margin : float, optional
        Largest relative margin of the Lyapunov certificate; positive where it fails.
    coupling : str, optional
        That the run had.
    coupling_why : str, optional
        Where "auto" was to find it: which it was, and why, in one line.
    trust_error : float, optional
        Where error bars were asked for, the widest band relative to the peak of its variable.
    trust_verdict, trust_line : str, optional
        As in `congelation.cosim.result.Trust`.
    """

    status: str
    message: str = ""
    cause: str | None = None
    metrics: Mapping[str, float | None] = field(default_factory=dict)
    deviations: Mapping[str, float] = field(default_factory=dict)
    steps: int | None = None
    rejected_steps: int | None = None
    iterations: int | None = None
    estimated_error: float | None = None
    wall_time: float | None = None
    warnings: int | None = None
    worst_margin: float | None = None
    coupling: str | None = None
    coupling_why: str | None = None
    trust_error: float | None = None
    trust_verdict: str | None = None
    trust_line: str | None = None

    @property
    def remark(self) -> str:
        """What there is to say of a run that reached its stop time; empty if nothing is."""
        if self.status != Status.COMPLETED.name:
            return ""
        return self.message.removeprefix(Status.COMPLETED.value).strip()

    @property
    def failed(self) -> bool:
        """Whether the run ended otherwise than at its stop time or by an FMU's own end."""
        return self.status not in (Status.COMPLETED.name, Status.TERMINATED.name)


@final
@dataclass(frozen=True, kw_only=True)
class RunRecord(Outcome):
    """What is known of one run.

    A field is one column of that name (`trust_error`: ``trust.error``), a mapping has one column
    per entry (``set.controller.epsilon``, ``metric.peak_x``). None: not known, or not applicable.

    Parameters
    ----------
    run_id : str
        Hash of what the run consists of.
    study : str
        Hash of the study that planned it last.
    number : int
        Its place in that study's plan.
    variant : str
    replicate : int, optional
        Number of the repetition, from 1.
    settings : mapping
        The values that differ between the runs of the study or that options of the command gave,
        by ``component.variable`` or ``experiment.key``; None for a start value left to the FMU.
    fmus : mapping
        SHA-256 of the FMU of each component.
    seed : int, optional
        That the sweep was drawn with.
    code_version : str
    numerics_version : int
    """

    run_id: str
    study: str = ""
    number: int = 0
    variant: str
    replicate: int | None = None
    settings: Mapping[str, Scalar | None] = field(default_factory=dict)
    fmus: Mapping[str, str] = field(default_factory=dict)
    seed: int | None = None
    code_version: str = ""
    numerics_version: int = 0

    def row(self) -> dict[str, Any]:
        """The record by column."""
        row: dict[str, Any] = {}
        for name, column in COLUMNS.items():
            value = getattr(self, name)
            if name in GROUPS:
                row.update({f"{column}{key}": entry for key, entry in value.items()})
            else:
                row[column] = value
        return row

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> RunRecord:
        """The record that a row holds; of deviations and FMUs, those that there are."""
        values: dict[str, Any] = {
            name: row[column] for name, column in COLUMNS.items() if column in row
        }
        for name, prefix in GROUPS.items():
            group = {k.removeprefix(prefix): v for k, v in row.items() if k.startswith(prefix)}
            if name in ("deviations", "fmus"):
                group = {key: value for key, value in group.items() if value is not None}
            values[name] = group
        return cls(**values)


_FIRST = ("run_id", "study", "number", "variant", "replicate", "settings")
COLUMNS: Mapping[str, str] = {
    name: GROUPS.get(name, name.replace("trust_", "trust."))
    for name in dict.fromkeys((*_FIRST, *(f.name for f in fields(RunRecord))))
}
"""The columns by field, in order; of several values, what their names begin with."""


@dataclass(frozen=True)
class Steps:
    """The communication steps of a run: how long each was. Of many steps some are kept.

    Parameters
    ----------
    count : int
        Of all steps.
    time : numpy.ndarray
        Shape (N,): when each of the steps that are kept ended, in seconds.
    length : numpy.ndarray
        Shape (N,), in seconds: the first, the last, the shortest and the longest of each of
        `STRETCHES` stretches.
    """

    count: int
    time: Array
    length: Array

    @classmethod
    def between(cls, points: Array) -> Steps:
        """The steps from each of some communication points to the next.

        A point at which something jumps may stand there twice.
        """
        length = np.diff(points)
        ends, length = points[1:][length > 0.0], length[length > 0.0]
        # Equal steps differ by the rounding of the times.
        equal = len(length) > 0 and np.ptp(length) <= EQUAL * length[0]
        rows = np.array([0, len(length) - 1]) if equal else thin(length, STRETCHES)
        return cls(len(length), ends[rows], length[rows])

    def to_json(self) -> str:
        """As a text; seven digits are enough for a plot."""
        lists = {
            name: [float(f"{v:.7g}") for v in getattr(self, name)] for name in ("time", "length")
        }
        return json.dumps({"count": self.count, **lists})

    @classmethod
    def of_json(cls, text: str | bytes) -> Steps:
        """What `to_json` wrote."""
        found = json.loads(text)
        return cls(found["count"], np.array(found["time"]), np.array(found["length"]))


STRETCHES = 250
"""Of which the shortest and the longest step are kept: as many as a plot on a phone shows."""

EQUAL = 1e-6
"""Steps that differ by less, relative to the first, are of one length."""


@dataclass(frozen=True)
class Trajectory:
    """A recorded run: row k of `values` belongs to ``time[k]``.

    Parameters
    ----------
    time : numpy.ndarray
        Shape (N,), in seconds.
    columns : tuple of str
        M names ``component.variable``.
    values : numpy.ndarray
        Shape (N, M).
    units : mapping
        Unit of each column; a missing or empty one is dimensionless.
    steps : Steps, optional
        The communication steps, which the rows do not show where they are on a grid of their own.
    signals : mapping
        Columns that are a given function of time, each with what determines it: of two runs with
        equal entries the column is the same curve, whatever their rows.
    """

    time: Array
    columns: tuple[str, ...]
    values: Array
    units: Mapping[str, str]
    steps: Steps | None = None
    signals: Mapping[str, object] = field(default_factory=dict)

    def group(self, name: str) -> tuple[str, ...]:
        """Columns called `name` or ``name[..]``, in order; ``plant.x`` is all of the vector x."""
        return tuple(c for c in self.columns if c == name or c.startswith(f"{name}["))

    def select(self, columns: Sequence[str]) -> Array:
        """The values of some columns, shape (N, len(columns))."""
        return self.values[:, [self.columns.index(c) for c in columns]]


@dataclass(frozen=True)
class Study:
    """The records of a study, and how to read them.

    Parameters
    ----------
    records : tuple of RunRecord
        In the order of the plan.
    about : mapping
        Title, scenario text, figures, metric definitions and versions, as they were stored.
    """

    records: tuple[RunRecord, ...]
    about: Mapping[str, Any]

    def signals(self, run: RunRecord) -> dict[str, object]:
        """The columns that follow from a profile alone, theta(t), with what determines them."""
        found: dict[str, object] = {}
        for column, profile in self.about.get("profiles", {}).items():
            fmu = self.about["fmus"][column.partition(".")[0]]["sha256"]
            numbers = {name: run.settings.get(name, value) for name, value in profile.items()}
            # A text is the name of a file, which another study may have found with other content.
            own = (run.study,) if any(isinstance(v, str) and v for v in numbers.values()) else ()
            found[column] = (fmu, *numbers.values(), *own)
        return found


def thin(values: Array, bins: int) -> npt.NDArray[np.intp]:
    """The rows that can be seen: the first and last, and the extremes of each of some bins."""
    finite = np.flatnonzero(np.isfinite(values))
    if len(finite) <= 2 * bins:
        return finite
    values = values[finite]
    # Bins of equal width; the last one is filled up with what is no extreme.
    width = -(-len(finite) // bins)
    first = np.arange(0, len(finite), width)
    padding = len(first) * width - len(finite)
    keep = [np.array([0, len(finite) - 1])]
    for find, other in ((np.argmin, np.inf), (np.argmax, -np.inf)):
        table = np.append(values, np.full(padding, other)).reshape(len(first), width)
        keep.append(first + find(table, axis=1))
    rows: npt.NDArray[np.intp] = finite[np.unique(np.concatenate(keep))]
    return rows
