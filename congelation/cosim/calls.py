"""Several functions as one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

__all__ = ["chained"]


def chained(calls: Sequence[Callable[[], None]]) -> Callable[[], None]:
    """A function that calls each; the function itself where there is one."""
    if len(calls) == 1:
        return calls[0]

    def chain() -> None:
        for call in calls:
            call()

    return chain
