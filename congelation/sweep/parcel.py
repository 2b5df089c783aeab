"""A file sent to the workers of a dask cluster. Imported where dask.distributed is known to be."""

from __future__ import annotations

import hashlib
from pathlib import Path

from distributed import Worker
from distributed.diagnostics.plugin import WorkerPlugin

from congelation.results.store import replace_whole

__all__ = ["FOLDER", "Parcel"]

FOLDER = "congelation"
"""Name of the folder in each worker's own directory that parcels are unpacked into."""


class Parcel(WorkerPlugin):
    """Content and place of a file; every worker process gets it once, also one that starts late.

    The scheduler keeps it for the sweeps to come, and sends no content twice.

    Parameters
    ----------
    place : str
        Where it is put, below `FOLDER`: the hash of its content, and a name.
    data : bytes
    """

    idempotent = True

    def __init__(self, place: str, data: bytes) -> None:
        self.name = f"congelation: {place}"
        self.place = place
        self.data = data

    def setup(self, worker: Worker) -> None:
        """Unpack it.

        Raises
        ------
        OSError
            If it arrives other than it was sent.
        """
        if hashlib.sha256(self.data).hexdigest() != self.place.partition("/")[0]:
            raise OSError(f"{self.place} has arrived damaged at {worker.address}")
        file = Path(worker.local_directory) / FOLDER / self.place
        replace_whole(file, lambda temporary: temporary.write_bytes(self.data))
