"""What a user opens: the runs of a result directory as a table, their trajectories and figures."""

from __future__ import annotations

import html
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import numpy.typing as npt

from congelation.arguments import checked
from congelation.errors import InvalidInput, counted, nearest, shown
from congelation.results.print_figures import WIDTH, draw, draw_panels
from congelation.results.record import GROUPS, RunRecord, Study, Trajectory
from congelation.results.store import ANEW, ENDED, Store

if TYPE_CHECKING:  # extras, or slow to import
    import pandas
    from matplotlib.figure import Figure

__all__ = ["Results", "Runs", "open_results"]

SHOWN = 6
"""Rows that a repr shows: ten lines in all."""

SHOWN_COLUMNS = 8

CELL = 32
"""Characters that a cell of a repr shows at most."""

PLOTTED = 8
"""Runs that a figure shows; more cannot be told apart."""


class Runs(Sequence[RunRecord]):
    """The finished runs as a table: iterate over records, index them, or take a column by name.

    Rows are read when they are asked for, so a table of a million runs takes no memory.

    Parameters
    ----------
    store : Store
    study : str, optional
        Only the runs of this study.
    """

    def __init__(self, store: Store, study: str | None = None) -> None:
        self._store = store
        self._study = study

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns; settings and metrics of other studies are left out."""
        about = self._store.about(self._study) if self._study is not None else {}
        own = {f"set.{name}" for name in about.get("varied", ())}
        own |= {f"metric.{name}" for name in about.get("metrics", ())}

        def listed(name: str) -> bool:
            of_study = name.startswith((GROUPS["settings"], GROUPS["metrics"]))
            return name in own or not (of_study and self._study is not None)

        return tuple(name for name in self._store.columns() if listed(name))

    def rows(self) -> Iterator[dict[str, Any]]:
        """Every run by column."""
        names = self.columns
        for row in self._store.rows(self._study):
            yield {name: row[name] for name in names}

    def __len__(self) -> int:
        # Not `count`, to which a directory that is gone has no runs.
        ((count,),) = self._store.query("SELECT count(*) FROM runs {where}", self._study)
        return int(count)

    def __iter__(self) -> Iterator[RunRecord]:
        return map(RunRecord.of, self.rows())

    @overload
    def __getitem__(self, key: int) -> RunRecord: ...
    @overload
    def __getitem__(self, key: slice) -> list[RunRecord]: ...
    @overload
    def __getitem__(self, key: str) -> npt.NDArray[Any]: ...
    def __getitem__(self, key: int | slice | str) -> Any:
        if isinstance(key, slice):
            return list(self)[key]
        if isinstance(key, str):
            return self._column(key)
        if not isinstance(key, Integral):
            raise InvalidInput(
                f"runs[{shown(key)}]: give a number, a slice or the name of a column"
            )
        place = key + len(self) if key < 0 else key
        for number, record in enumerate(self):
            if number == place:
                return record
        raise IndexError(f"no run has the number {key}; there are {len(self)}")

    def _column(self, name: str) -> npt.NDArray[Any]:
        """One column: numbers with nan for what is missing, or objects.

        Tables print settings and metrics without what the names of their columns begin with.
        """
        if name not in self.columns:
            named = [c for c in (f"metric.{name}", f"set.{name}") if c in self.columns]
            if len(named) != 1:
                raise InvalidInput(f"'{name}' is no column; {nearest(name, self.columns)}")
            name = named[0]
        values = [row[name] for row in self._store.rows(self._study)]
        if any(isinstance(value, bool | str) for value in values):
            return np.array(values, dtype=object)
        return np.array([np.nan if value is None else value for value in values])

    def __repr__(self) -> str:
        lines = self._shown()
        widths = [min(CELL, max(map(len, column))) for column in zip(*lines, strict=True)]
        return "\n".join(
            "  ".join(
                cell[:width].ljust(width) for cell, width in zip(line, widths, strict=True)
            ).rstrip()
            for line in lines
        )

    def _repr_html_(self) -> str:
        head, *lines = self._shown()
        cells = "".join(f"<th>{html.escape(cell)}</th>" for cell in head)
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in line) + "</tr>"
            for line in lines
        )
        return f"<table><tr>{cells}</tr>{body}</table>"

    def _shown(self) -> list[list[str]]:
        """The first rows: what a run is, how it ended, its metrics."""
        middle = [n for n in self.columns if n.startswith(("set.", "metric."))]
        names = ["run_id", "variant", "status", *middle][:SHOWN_COLUMNS]
        lines = [[name.partition(".")[2] or name for name in names]]
        for row, _ in zip(self.rows(), range(SHOWN), strict=False):
            lines.append([_text(row[name]) for name in names])
        return lines


class Results:
    """A result directory.

    Parameters
    ----------
    folder : Path
    study : str, optional
        Only what belongs to this study; by default everything in the folder.

    Attributes
    ----------
    folder : Path
    runs : Runs

    Examples
    --------
    >>> results = cg.open_results("results/scalar")
    >>> results.runs["status"].tolist()
    ['COMPLETED', 'COMPLETED']
    >>> results.trajectory(results.runs[0].run_id).columns[0]
    'plant.x'
    >>> results.plot().savefig(folder / "scalar.png")
    """

    def __init__(self, folder: Path | str, study: str | None = None) -> None:
        self.folder = Path(folder)
        self.store = Store(self.folder)
        self.runs = Runs(self.store, study)
        self._study = study

    @property
    def about(self) -> Mapping[str, Any]:
        """Title, scenario text, metrics, figures and versions of the study."""
        return self.store.about(self._study)

    def study(self) -> Study:
        """The records of the newest study, and how to read them.

        Raises
        ------
        InvalidInput
            If this is no result directory.
        """
        newest = self._study or self.store.newest()
        about = self.store.about(newest)
        if not about:
            raise InvalidInput(f"{self.store.database} says nothing of its study; {ANEW}")
        return Study(tuple(Runs(self.store, newest)), about)

    def lost_trajectories(self) -> list[str]:
        """Run_ids of completed runs whose trajectory is gone; of a sweep, if it has others."""
        study = self.study()
        ended = [run.run_id for run in study.records if run.status in ENDED]
        lost = self.store.without_trajectory(ended)
        return [] if study.about["swept"] and len(lost) == len(ended) else lost

    @checked
    def trajectory(self, run_id: str | RunRecord) -> Trajectory:
        """The trajectory of a run, or of that whose run_id begins so.

        Raises
        ------
        InvalidInput
            If there is no such run, or it has no trajectory.
        """
        name = run_id if isinstance(run_id, str) else run_id.run_id
        return self.store.trajectory(self.store.find(name))

    def to_pandas(self) -> pandas.DataFrame:
        """The runs as a pandas data frame, a row per run.

        Raises
        ------
        InvalidInput
            If pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise InvalidInput(
                "to_pandas needs pandas; install it with: pip install congelation[pandas]"
            ) from error
        return pandas.DataFrame(list(self.runs.rows()), columns=list(self.runs.columns))

    def figures(self) -> tuple[str, ...]:
        """Names of the figures that can be drawn; none of a sweep, nor without trajectories."""
        study = self.study()
        kept = any(self.store.trajectory_file(run.run_id).is_file() for run in study.records)
        if study.about["swept"] or not kept:
            return ()
        return tuple(str(figure["name"]) for figure in study.about["figures"])

    @checked
    def plot(self, name: str | None = None, width: float = WIDTH) -> Figure:
        """A figure of the newest study, as Matplotlib's object.

        Parameters
        ----------
        name : str, optional
            One of the figures that the scenario defines; by default the first. A scenario
            without figures gets one panel per recorded variable.
        width : float, optional
            Of the figure, in inches; by default a column of a journal.

        Raises
        ------
        InvalidInput
            If there is no such figure, or no trajectory was kept.
        """
        study = self.study()
        kept = [r for r in study.records if self.store.trajectory_file(r.run_id).is_file()][
            :PLOTTED
        ]
        if not kept:
            raise InvalidInput(f"{self.folder} holds no trajectories to plot")
        runs = [
            (r, replace(self.store.trajectory(r.run_id), signals=study.signals(r))) for r in kept
        ]
        _let_notebooks_show_figures()
        if name is None and not study.about["figures"]:
            panels = dict.fromkeys(c.partition("[")[0] for c in runs[0][1].columns)
            return draw_panels(runs, tuple(panels), width=width)
        return draw(study, runs, name, width)

    def __repr__(self) -> str:
        if not self.store.database.is_file():
            return f"Results: {self.folder} is no result directory"
        title = self.about.get("title", "")
        more = len(self.runs) - SHOWN
        lines = [f"{title or 'Results'}: {counted(len(self.runs), 'run')} in {self.folder}"]
        if len(self.runs):
            lines.append(repr(self.runs))
        return "\n".join([*lines, *([f".. and {more} more"] if more > 0 else [])])

    def _repr_html_(self) -> str:
        title, runs = self.about.get("title", "Results"), counted(len(self.runs), "run")
        text = f"{title}: {runs} in {self.folder}"
        return f"<p>{html.escape(text)}</p>{self.runs._repr_html_()}"


@checked
def open_results(folder: Path | str) -> Results:
    """Open the directory that `run` or `sweep` wrote.

    Raises
    ------
    InvalidInput
        If it is no result directory, or of an earlier version.

    Examples
    --------
    >>> len(cg.open_results("results/scalar").runs)
    2
    """
    results = Results(folder)
    if results.folder.is_file():
        raise InvalidInput(
            f"{folder} is a file, not a result directory; give the directory that "
            "`congelation run` or `sweep` wrote"
        )
    results.store.columns()  # complains if it is none
    return results


def _text(value: object) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _let_notebooks_show_figures() -> None:
    """What ``%matplotlib inline`` does, which pyplot, not used here, would do by itself."""
    if "IPython" not in sys.modules:
        return
    from IPython import get_ipython
    from IPython.core.pylabtools import select_figure_formats

    if (shell := get_ipython()) is not None:
        select_figure_formats(shell, {"png"})
