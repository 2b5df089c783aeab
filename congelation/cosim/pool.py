"""Instances kept for the next run: a reset costs less than a new instance, and leaks nothing."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType

from congelation.cosim.system import Member
from congelation.errors import SlaveError
from congelation.fmi.slave import Slave

__all__ = ["SlavePool"]


class SlavePool:
    """Loaded FMU instances, by the content of their FMUs.

    Use it as a context manager around several runs; leaving it frees every instance.
    """

    def __init__(self) -> None:
        self._idle: dict[tuple[str, str], list[Slave]] = defaultdict(list)

    @contextmanager
    def lend(self, members: Sequence[Member]) -> Iterator[list[Slave]]:
        """One instance per member, fresh or reset, for the time of a run.

        Raises
        ------
        InvalidInput, SlaveError
            An FMU that cannot be loaded.
        """
        lent: list[Slave] = []
        try:
            for member in members:
                lent.append(self._take(member))
            yield lent
        finally:
            for slave in lent:
                self._put_back(slave)

    def close(self) -> None:
        """Free every instance that is not lent."""
        for slaves in self._idle.values():
            for slave in slaves:
                slave.close()
        self._idle.clear()

    def __enter__(self) -> SlavePool:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _take(self, member: Member) -> Slave:
        idle = self._idle[member.name, member.description.sha256]
        return idle.pop() if idle else Slave(member.name, member.description)

    def _put_back(self, slave: Slave) -> None:
        if slave.usable:
            try:
                slave.reset()
            except SlaveError:
                slave.close()
            else:
                self._idle[slave.name, slave.description.sha256].append(slave)
