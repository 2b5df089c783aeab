"""Sweeps on workers that share no file system with the parent: files go out, results come back.

Every FMU and profile table is sent under the hash of its content. A worker keeps them in a folder
of its own, plans each run with the paths there, and stores it there; what was stored is the result
of the task, which the parent writes into its own store.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from congelation.cosim.system import Component
from congelation.results.records import Row
from congelation.results.store import Store
from congelation.scenario.scenario import Scenario
from congelation.sweep.workers import Done, Shipment, Task, Work, last_words

__all__ = ["Cargo", "aboard", "cargo_of"]

T = TypeVar("T")


@dataclass(frozen=True)
class Cargo:
    """The files that the runs of a sweep read.

    Parameters
    ----------
    places : mapping
        By the path that the sweep knows it by, where a file is put on a worker: HASH/NAME.
    contents : mapping
        The bytes of each place.
    """

    places: Mapping[str, str]
    contents: Mapping[str, bytes]


def cargo_of(shared: Work, tasks: Sequence[Task]) -> Cargo:
    """What has to be sent so that the tasks of a sweep can be done elsewhere."""
    components = shared.scenario.system.components
    named = [value for component in components for value in component.start.values()]
    named += [value for task in tasks for value in task.settings.values()]
    tables = {value for value in named if isinstance(value, str) and Path(value).is_file()}
    places: dict[str, str] = {}
    contents: dict[str, bytes] = {}
    for path in sorted({str(component.fmu) for component in components} | tables):
        data = Path(path).read_bytes()
        places[path] = f"{hashlib.sha256(data).hexdigest()}/{Path(path).name}"
        contents[places[path]] = data
    return Cargo(places, contents)


def aboard(
    do: Callable[[Work, Sequence[Task]], T],
    session: str,
    places: Mapping[str, str],
    shared: Work,
    tasks: Sequence[Task],
) -> T:
    """Do tasks in a dask worker, with the files that were sent to it.

    Parameters
    ----------
    do : callable
        `work` or `pilot`.
    session : str
        Name of this use of the cluster, for what a worker leaves to be read by others.
    places : mapping
        As in `Cargo`.
    shared, tasks
        As `do` takes them, with the paths of the parent.

    Returns
    -------
    What `do` returns; a `Done` with the rows and trajectories of the tasks.
    """
    from distributed import get_worker

    from congelation.sweep.parcel import FOLDER

    worker = get_worker()
    root = Path(worker.local_directory) / FOLDER
    here = {path: str(root / place) for path, place in places.items()}
    there = {local: path for path, local in here.items()}
    local = replace(shared, store=Store(root / "results"), scenario=_moved(shared, here))
    local.store.create()
    for row in _left_by_others(worker, session, tasks):
        local.store.write(row)
    last_words(partial(_leave, worker, session))
    result = do(
        local,
        [replace(t, settings=_renamed(t.settings, here), replaces=None) for t in tasks],
    )
    if not isinstance(result, Done):
        return result
    finished = [task.run_id for task in tasks[: len(result.statuses)]]
    shipments = tuple(_packed(local.store, run_id, there) for run_id in finished)
    local.store.remove(finished)
    return replace(result, shipments=shipments)


def _moved(shared: Work, here: Mapping[str, str]) -> Scenario:
    """The scenario of a sweep with the paths of this machine."""

    def moved(component: Component) -> Component:
        fmu = Path(here[str(component.fmu)])
        return replace(component, fmu=fmu, start=_renamed(component.start, here))

    system = shared.scenario.system
    components = tuple(moved(component) for component in system.components)
    return replace(shared.scenario, system=replace(system, components=components))


def _renamed(values: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Values, with other names for files."""
    return {
        name: names.get(value, value) if isinstance(value, str) else value
        for name, value in values.items()
    }


def _packed(store: Store, run_id: str, there: Mapping[str, str]) -> Shipment:
    """A stored run, with the paths of the parent wherever its row has those of this machine."""
    row = store.row(run_id)
    for name, value in row.items():
        if isinstance(value, str):
            for local, path in there.items():
                row[name] = row[name].replace(local, path)
    file = store.trajectory_file(run_id)
    return Shipment(row, file.read_bytes() if file.is_file() else None)


def _leave(worker: Any, session: str, row: Row) -> None:
    """Leave the row of a run that this process will not outlive with the scheduler."""
    keys = [session, str(row["run_id"])]
    _ask(worker, partial(worker.scheduler.set_metadata, keys=keys, value=dict(row)))


def _left_by_others(worker: Any, session: str, tasks: Sequence[Task]) -> list[Row]:
    """Rows of some tasks that ended the worker which had them before."""
    rows = _ask(worker, partial(worker.scheduler.get_metadata, keys=[session], default={}))
    return [rows[task.run_id] for task in tasks if task.run_id in rows]


def _ask(worker: Any, request: Callable[[], Any]) -> Any:
    """The answer of the scheduler; dask's own threads await it."""
    from distributed.utils import sync

    return sync(worker.loop, request)
