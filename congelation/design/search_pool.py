"""The worker processes of searches: Ctrl-C is their parent's alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, TypeVar

from congelation.sweep.process import interrupts_held, without_main

__all__ = ["SearchPool"]

T = TypeVar("T")


class SearchPool:
    """Processes that are started afresh, and killed where the search is interrupted or fails.

    Parameters
    ----------
    workers : int
    prepare : callable, optional
        Called in each process before it does anything, with `arguments`.
    arguments : tuple
    """

    def __init__(
        self,
        workers: int,
        prepare: Callable[..., object] | None = None,
        arguments: tuple[Any, ...] = (),
    ) -> None:
        self._pool = ProcessPoolExecutor(
            workers,
            get_context("spawn"),
            prepare,
            arguments,
        )

    def submit(self, function: Callable[..., T], *arguments: Any) -> Future[T]:
        """Have a process call a function."""
        # A process starts here. It would print a traceback of its imports on Ctrl-C, and run the
        # script of its parent once more.
        with interrupts_held(), without_main():
            return self._pool.submit(function, *arguments)

    def map(self, function: Callable[[Any], T], items: Iterable[object]) -> Iterator[T]:
        """What a function returns for each item, in their order."""
        futures = [self.submit(function, item) for item in items]
        return (future.result() for future in futures)

    def __enter__(self) -> SearchPool:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if error is not None:  # nobody waits for what they are doing
            for process in list((self._pool._processes or {}).values()):
                process.kill()
        self._pool.shutdown(cancel_futures=True)
