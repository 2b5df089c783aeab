"""Programs in processes of their own, as seen by the benchmarks."""

from __future__ import annotations

import json
import select
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType

import numpy as np
import numpy.typing as npt

from benchmarks.engines import ENGINES
from benchmarks.loop import Loop

__all__ = ["EngineError", "Worker", "workers"]

Floats = npt.NDArray[np.float64]

ROOT = Path(__file__).absolute().parent.parent
LONGEST_ANSWER = 600.0
"""Seconds after which an engine that does not answer counts as failed."""


class EngineError(RuntimeError):
    """An engine that failed; one line."""


class Worker:
    """A process with one program and one loop.

    Parameters
    ----------
    engine : str
        A module of benchmarks.engines; a name in ENGINES, or one that runs in this environment.
    loop : Loop

    Raises
    ------
    EngineError
        The engine's environment is not there, or the engine does not load the loop.
    """

    def __init__(self, engine: str, loop: Loop) -> None:
        python = _interpreter(ENGINES[engine].environment if engine in ENGINES else "")
        self.engine = engine
        self._columns = 1 + len(loop.record)
        self._log = tempfile.TemporaryFile()  # noqa: SIM115  # closed by close()
        self._process = subprocess.Popen(
            [python, "-m", "benchmarks.worker", engine],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            cwd=ROOT,
        )
        try:
            self._ask(loop.to_json())
        except EngineError:
            self.close()
            raise

    def seconds(self, **settings: float | str) -> float:
        """Seconds that a run takes."""
        return float(self._ask(json.dumps({"settings": settings, "rows": None}))["seconds"])

    def trajectory(self, **settings: float | str) -> tuple[float, Floats]:
        """Seconds, and rows (time, recorded values), shape (N, 1 + number of columns)."""
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "rows"
            answer = self._ask(json.dumps({"settings": settings, "rows": str(file)}))
            return float(answer["seconds"]), np.fromfile(file, np.float64).reshape(
                -1, self._columns
            )

    def _ask(self, line: str) -> Mapping[str, float]:
        process = self._process
        if process.stdin is None or process.stdout is None:
            raise EngineError(f"{self.engine}: no pipes")
        try:
            process.stdin.write(line + "\n")
            process.stdin.flush()
        except BrokenPipeError:
            raise EngineError(f"{self.engine}: {self._last_words()}") from None
        ready, _, _ = select.select([process.stdout], [], [], LONGEST_ANSWER)
        if not ready:
            raise EngineError(f"{self.engine}: no answer within {LONGEST_ANSWER:g} s")
        text = process.stdout.readline()
        if not text:
            raise EngineError(f"{self.engine}: {self._last_words()}")
        answer: dict[str, float] = json.loads(text)
        if "error" in answer:
            raise EngineError(f"{self.engine}: {answer['error']}")
        return answer

    def _last_words(self) -> str:
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"ended with code {self._process.poll()}"

    def close(self) -> None:
        """End the process."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._log.close()

    def __enter__(self) -> Worker:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _interpreter(environment: str) -> str:
    if not environment:
        return sys.executable
    python = ROOT / environment / "bin" / "python"
    if not python.exists():
        raise EngineError(f"{environment} is not there; run `make {environment}/installed`")
    return str(python)


@contextmanager
def workers(loops: Mapping[str, tuple[str, Loop]]) -> Iterator[tuple[dict[str, Worker], list[str]]]:
    """Start a worker for each (engine, loop), by its key.

    Yields
    ------
    dict of str to Worker
        Those that started.
    list of str
        Why the others did not.
    """
    started: dict[str, Worker] = {}
    failures: list[str] = []
    with ExitStack() as stack:
        for key, (engine, loop) in loops.items():
            try:
                started[key] = stack.enter_context(Worker(engine, loop))
            except EngineError as error:
                failures.append(str(error))
        yield started, failures
