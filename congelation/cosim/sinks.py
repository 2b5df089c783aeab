"""Where the rows of a run go: kept in memory, or written to a Parquet file, block by block."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from errno import EISDIR
from pathlib import Path

import numpy as np
import numpy.typing as npt

from congelation.errors import InvalidInput

__all__ = ["BLOCK_ROWS", "Memory", "ParquetFile", "Recorder", "Sink"]

Floats = npt.NDArray[np.float64]

BLOCK_ROWS = 8192
"""Rows per block: large enough that starting one costs nothing, small in memory."""


class Sink(ABC):
    """Takes the blocks of a run."""

    @abstractmethod
    def open(self, columns: Sequence[str]) -> None:
        """Get ready for blocks with these columns, "time" being the first."""

    @abstractmethod
    def write(self, block: Floats) -> None:
        """Take a block, shape (n, len(columns)), which may be kept."""

    def close(self) -> None:
        """No block will follow. Here, nothing is left to do."""
        return

    def abandon(self) -> None:
        """The run was broken off by an exception. Here, as `close`."""
        self.close()


class Memory(Sink):
    """Keeps every block."""

    def __init__(self) -> None:
        self._blocks: list[Floats] = []

    def open(self, columns: Sequence[str]) -> None:
        """Begin with nothing."""
        self._blocks = [np.empty((0, len(columns)))]

    def write(self, block: Floats) -> None:
        """Keep a block."""
        self._blocks.append(block)

    def rows(self) -> Floats:
        """All rows, shape (N, len(columns))."""
        return np.concatenate(self._blocks)


class ParquetFile(Sink):
    """Writes each block to a Parquet file as a row group, so memory stays the same however long
    the run.

    The file appears under its name when it is complete; until then it is called "<name>.part".

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        # Absolute, as an FMU may change the working directory.
        self.path = Path(path).absolute()
        self._part = self.path.with_name(self.path.name + ".part")

    def open(self, columns: Sequence[str]) -> None:
        """Create the file.

        Raises
        ------
        InvalidInput
            It cannot be written there.
        """
        # It takes an eighth of the time in which a process starts, and few runs write files.
        import pyarrow
        import pyarrow.parquet

        self._schema = pyarrow.schema([(name, pyarrow.float64()) for name in columns])
        try:
            if self.path.is_dir():
                raise IsADirectoryError(EISDIR, "it is a directory")
            self._writer = pyarrow.parquet.ParquetWriter(self._part, self._schema)
        except OSError as error:
            raise InvalidInput(f"{self.path} cannot be written: {error.strerror}") from error

    def write(self, block: Floats) -> None:
        """Write a row group."""
        import pyarrow

        if len(block):
            columns = [pyarrow.array(column) for column in block.T]
            self._writer.write_table(pyarrow.Table.from_arrays(columns, schema=self._schema))

    def close(self) -> None:
        """Complete the file and give it its name."""
        self._writer.close()
        self._part.replace(self.path)

    def abandon(self) -> None:
        """Complete what is there, but leave it under the name of a part."""
        self._writer.close()


class Recorder:
    """Takes rows (time, values..) and hands full blocks to a sink.

    Parameters
    ----------
    columns : sequence of str, length M
        Names of the values.
    sink : Sink
        It is opened; leaving the recorder as a context closes it.

    Attributes
    ----------
    last : array, shape (1 + M,) or (0,)
        The newest row that was handed over; empty before the first.
    peaks : array, shape (1 + M,)
        The largest size of each number in the rows that were handed over.
    """

    def __init__(self, columns: Sequence[str], sink: Sink) -> None:
        self._sink = sink
        self._rows = 0
        self._block = np.empty((BLOCK_ROWS, 1 + len(columns)))
        self.last: Floats = np.empty(0)
        self.peaks: Floats = np.zeros(1 + len(columns))
        sink.open(["time", *columns])

    def row(self, time: float) -> Floats:
        """A new row for `time`; its values, shape (M,), are for the caller to fill."""
        if self._rows == BLOCK_ROWS:
            self._hand_over()
            self._block = np.empty_like(self._block)
        row: Floats = self._block[self._rows]
        self._rows += 1
        row[0] = time
        return row[1:]

    @property
    def room(self) -> Floats:
        """The rows of the block that are still free, shape (n, 1 + M), n >= 1, for compiled code
        to fill; see `filled`."""
        if self._rows == BLOCK_ROWS:
            self._hand_over()
            self._block = np.empty_like(self._block)
        return self._block[self._rows :]

    def filled(self, count: int) -> None:
        """The first rows of `room` have been filled."""
        self._rows += count

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """Hand over what is left, and close the sink."""
        self._hand_over()
        if error is None:
            self._sink.close()
        else:
            self._sink.abandon()

    def _hand_over(self) -> None:
        block = self._block[: self._rows]
        if len(block):
            self.last = block[-1].copy()
            self.peaks = np.maximum(self.peaks, np.abs(block).max(axis=0))
            self._sink.write(block)
        self._rows = 0
