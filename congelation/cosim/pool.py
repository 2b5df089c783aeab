"""Instances kept for the next run: a reset costs less than a new instance, and leaks nothing."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from operator import is_
from types import TracebackType

from congelation.cosim.session import Session
from congelation.cosim.system import Member
from congelation.errors import SlaveError
from congelation.fmi.slave import Slave

__all__ = ["SlavePool"]

KEPT_SESSIONS = 8
"""Runs of a study differ in start values alone, or in a coupling and its step as well."""


class SlavePool:
    """Loaded FMU instances, by the content of their FMUs.

    Use it as a context manager around several runs; leaving it frees every instance.
    """

    def __init__(self) -> None:
        self._idle: dict[tuple[str, str, bool], list[Slave]] = defaultdict(list)
        self._sessions: deque[tuple[object, Session]] = deque(maxlen=KEPT_SESSIONS)

    def session(self, key: object, slaves: Sequence[Slave], make: Callable[[], Session]) -> Session:
        """What is set up for a run: kept from an earlier run with these instances, or made.

        Parameters
        ----------
        key : object
            What it follows from besides the instances; it is compared with those of earlier runs.
        slaves : sequence of Slave
            Those that were lent.
        make : callable
        """
        for known, session in self._sessions:
            if known == key and all(map(is_, session.ensemble.slaves, slaves)):
                return session
        session = make()
        self._sessions.append((key, session))
        return session

    @contextmanager
    def lend(self, members: Sequence[Member], *, exchange: bool = False) -> Iterator[list[Slave]]:
        """One instance per member, fresh or reset, for the time of a run.

        Parameters
        ----------
        members : sequence of Member
        exchange : bool
            Whether they are to be ones of model exchange, rather than of co-simulation.

        Raises
        ------
        InvalidInput, SlaveError
            An FMU that cannot be loaded.
        """
        lent: list[Slave] = []
        try:
            for member in members:
                lent.append(self._take(member, exchange))
            yield lent
        finally:
            for slave in lent:
                self._put_back(slave)

    def terminate(self) -> list[str]:
        """Call fmi2Terminate of each instance whose run has reached its end and that is not lent.

        Returns
        -------
        list of str
            A line for each FMU that refused.
        """
        idle = [slave for slaves in self._idle.values() for slave in slaves]
        return [line for slave in idle if (line := slave.terminate())]

    def close(self) -> None:
        """Free every instance that is not lent."""
        for slaves in self._idle.values():
            for slave in slaves:
                slave.close()
        self._idle.clear()
        self._sessions.clear()

    def __enter__(self) -> SlavePool:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _take(self, member: Member, exchange: bool) -> Slave:
        idle = self._idle[member.name, member.description.sha256, exchange]
        while idle:
            slave = idle.pop()
            try:
                # Only now: an FMU that fails here fails after the rows of its run are safe.
                slave.reset()
            except SlaveError:
                slave.close()
            else:
                return slave
        return Slave(member.name, member.description, exchange=exchange)

    def _put_back(self, slave: Slave) -> None:
        if slave.usable:
            slave.free_states()
            self._idle[slave.name, slave.description.sha256, slave.exchange].append(slave)
