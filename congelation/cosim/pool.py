"""Instances kept for the next run: a reset costs less than a new instance, and leaks nothing."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from operator import is_

from congelation.cosim.session import Session
from congelation.cosim.system import Member
from congelation.errors import SlaveError
from congelation.fmi.slave import Slave
from congelation.fmi.start_values import StartValue

__all__ = ["SlavePool"]

Scalar = float | int | bool | str

KEPT_SESSIONS = 8
"""Runs of a study differ in start values alone, or in a coupling and its step as well."""


class SlavePool:
    """Loaded FMU instances, by the content of their FMUs.

    Use it as a context manager around several runs; leaving it frees every instance. Before an
    instance of an FMU is used again for the first time, it is compared with a new one: where
    fmi2Reset leaves something as the run before has left it, each run gets new instances.
    """

    def __init__(self) -> None:
        self._idle: dict[tuple[str, str, bool], list[Slave]] = defaultdict(list)
        self._sessions: deque[tuple[object, Session]] = deque(maxlen=KEPT_SESSIONS)
        self._resets: dict[tuple[str, bool], str] = {}
        self._worded: set[str] = set()  # hashes of FMUs of which runs have set Strings

    @cached_property
    def trials(self) -> SlavePool:
        """Instances for trials before a run, none of which is ever lent to a run."""
        return SlavePool()

    def renewed(self, members: Sequence[Member]) -> list[str]:
        """A line for each FMU of these that is instantiated anew for each run, and why."""
        hashes = dict.fromkeys(member.description.sha256 for member in members)
        lines = (
            self._resets.get((sha256, kind), "") for sha256 in hashes for kind in (True, False)
        )
        return [line for line in lines if line]

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
            for slave, member in zip(lent, members, strict=False):
                self._put_back(slave)
                sha256 = member.description.sha256
                if sha256 not in self._worded and any(
                    value.variable.type == "String" for value in member.start
                ):
                    # From now on, a reset has to bring Strings back, too.
                    self._worded.add(sha256)
                    self._resets.pop((sha256, exchange), None)

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
        if "trials" in vars(self):
            self.trials.close()

    def __enter__(self) -> SlavePool:
        return self

    def __exit__(self, *raised: object) -> None:
        self.close()

    def _take(self, member: Member, exchange: bool) -> Slave:
        idle = self._idle[member.name, member.description.sha256, exchange]
        while idle:
            slave = idle.pop()
            try:
                # Only now: an FMU that fails here fails after the rows of its run are safe.
                slave.reset()
                if self._is_as_new(slave, member):
                    return slave
            except SlaveError:
                pass
            slave.close()
        return Slave(member.name, member.description, exchange=exchange)

    def _is_as_new(self, slave: Slave, member: Member) -> bool:
        """Whether fmi2Reset makes an instance of this FMU as a new one is; looked at once.

        Both are initialised with what the FMU says, and all that can be read is compared; Strings
        only where runs have set any, as some FMUs give addresses that hold none. Where that is
        refused without the start values of the run, both are given those.

        Raises
        ------
        SlaveError
            The instance cannot be reset another time.
        """
        description = slave.description
        key = description.sha256, slave.exchange
        kinds: tuple[str, ...] = ("Real", "Integer", "Boolean", "String")
        kinds = kinds if description.sha256 in self._worded else kinds[:3]
        if key not in self._resets:
            differs = "what it does cannot be compared with that of a new one"
            for start in ((), member.start):
                new = Slave(slave.name, description, exchange=slave.exchange)
                try:
                    fresh, again = (_initial_values(s, start, kinds) for s in (new, slave))
                except SlaveError:
                    slave.reset()
                    continue
                finally:
                    new.close()
                slave.reset()
                names = [n for n, value in fresh.items() if not _same(value, again[n])]
                differs = f"{names[0]} is {again[names[0]]}, not {fresh[names[0]]}" if names else ""
                break
            self._resets[key] = differs and (
                f"{description.path.name} is instantiated anew for each run, as fmi2Reset does not "
                f"make it as new: {differs}"
            )
        return not self._resets[key]

    def _put_back(self, slave: Slave) -> None:
        if slave.usable:
            slave.free_states()
            self._idle[slave.name, slave.description.sha256, slave.exchange].append(slave)


def _initial_values(
    slave: Slave, start: tuple[StartValue, ...], kinds: Sequence[str]
) -> dict[str, Scalar]:
    """All variables of these types in initialization mode, by name.

    Raises
    ------
    SlaveError
    """
    slave.setup(0.0)
    slave.set_values(start)
    slave.enter_initialization()
    found: dict[str, Scalar] = {}
    for kind in kinds:
        variables = [
            v
            for v in slave.description.variables.values()
            if ("Integer" if v.type == "Enumeration" else v.type) == kind
            and v.causality != "independent"
        ]
        if variables:
            values = slave.get_values(kind, [v.reference for v in variables])
            found.update(zip((v.name for v in variables), values, strict=True))
    return found


def _same(a: Scalar, b: Scalar) -> bool:
    return a == b or (a != a and b != b)  # nan is as nan
