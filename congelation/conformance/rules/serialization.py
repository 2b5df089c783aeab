"""Rules about serialized FMU states (section 2.1.8)."""

from __future__ import annotations

import random
from collections.abc import Generator, Iterator
from contextlib import suppress

from congelation.conformance.bench import Bench, from_text
from congelation.conformance.binding import Status
from congelation.conformance.instance import Instance
from congelation.conformance.rule import Level, NotApplicable, Violated, dynamic
from congelation.conformance.rules.fmustate import restore, save
from congelation.conformance.trajectory import demand, excite, first_difference

__all__: list[str] = []

_GUARD = 64
_POINT = 4


def _needs_bytes(bench: Bench) -> None:
    if not bench.description.flag("canSerializeFMUstate"):
        raise NotApplicable("canSerializeFMUstate is false")


def _bytes(bench: Bench, instance: Instance) -> bytes:
    """The serialized state at communication point `_POINT`."""
    bench.run(instance, last=_POINT, quiet=True)
    state = save(instance)
    status, size = instance.serialized_size(state)
    demand(status, "fmi2SerializedFMUstateSize")
    status, data = instance.serialize(state, size)
    demand(status, "fmi2SerializeFMUstate")
    demand(instance.free_state(state), "fmi2FreeFMUstate")
    return data


@dynamic("FMI2-SERIAL-01", "2.1.8", Level.VIOLATION)
def replay(bench: Bench) -> Iterator[str]:
    """From a deserialized state the same and another instance repeat the simulation, to the last
    bit.

    Standard: fmi2DeSerializeFMUstate "constructs a copy of the FMU state"

    Why: Checkpoints continue a run.

    Remedy: Serialize every bit that the state holds

    Example: Numbers as text of six digits.
    """
    _needs_bytes(bench)
    with bench.held() as instance:
        data = _bytes(bench, instance)
        yield from _continued(bench, instance, data, "the same instance")
        if not bench.alone_only:
            with bench.held("another") as another:
                yield from _continued(bench, another, data, "another instance")


def _continued(bench: Bench, instance: Instance, data: bytes, label: str) -> Iterator[str]:
    status, state = instance.deserialize(data)
    demand(status, f"fmi2DeSerializeFMUstate in {label}")
    restore(instance, state, f" in {label}")
    yield from bench.compare(bench.run(instance, first=_POINT), label)
    demand(instance.free_state(state), "fmi2FreeFMUstate")


@dynamic("FMI2-SERIAL-02", "2.1.8", Level.ROBUSTNESS)
def another_process(bench: Bench) -> Iterator[str]:
    """A serialized state can be continued in another process, to the last bit.

    Standard: a note alone says that the byte vector can be stored on file and loaded whenever
    needed.

    Why: A checkpoint is read by another process.

    Remedy: Serialize values, no addresses

    Example: A pointer in the bytes.
    """
    _needs_bytes(bench)
    with bench.held() as instance:
        data = _bytes(bench, instance)
    try:
        text = bench.elsewhere("replay", argument=f"{_POINT}:{data.hex()}")
    except Violated as breach:
        yield str(breach)
        return
    difference = first_difference(from_text(text), bench.reference.after(_POINT))
    if difference is not None:
        yield f"in another process: {difference}"


@dynamic("FMI2-SERIAL-03", "2.1.8", Level.VIOLATION)
def size(bench: Bench) -> Iterator[str]:
    """fmi2SerializedFMUstateSize is the size that fmi2SerializeFMUstate fills, and no more is
    written.

    Standard: the size is "returned, in order that FMUstate can be stored in it"; the bytes go
    into a vector "of length size"

    Why: The host allocates that much.

    Remedy: Return the size that is written

    Example: A size that is 16 bytes short.
    """
    _needs_bytes(bench)
    with bench.held() as instance:
        bench.run(instance, last=_POINT)
        state = save(instance)
        sizes = {instance.serialized_size(state)[1] for _ in range(2)}
        if len(sizes) > 1:
            yield f"the size of one state is {' and then '.join(map(str, sizes))}"
        status, data = instance.serialize(state, max(sizes), guard=_GUARD)
        demand(status, "fmi2SerializeFMUstate")
        if data[max(sizes) :] != b"\xa5" * _GUARD:
            yield "fmi2SerializeFMUstate writes beyond the size it was given"
        demand(instance.free_state(state), "fmi2FreeFMUstate")


def _cut(data: bytes) -> dict[str, bytes]:
    """Bytes of a wrong length, by what was done to them."""
    return {
        "no bytes": b"",
        "the first byte alone": data[:1],
        "the first half": data[: len(data) // 2],
        "all but the last byte": data[:-1],
        "the bytes and one more": data + b"\0",
    }


def _noise(data: bytes) -> dict[str, bytes]:
    """Bytes of the right length that are no state of any FMU."""
    chance = random.Random(5)  # the same noise in every check
    return {"noise": chance.randbytes(len(data)), "zeros": bytes(len(data))}


@dynamic("FMI2-SERIAL-04", "2.1.3, 2.1.8", Level.ROBUSTNESS)
def spoiled_bytes(bench: Bench) -> Iterator[str]:
    """Truncated and extended bytes are not taken for a state; neither they nor noise do harm.

    Standard: nothing; a host reads checkpoints from files that may be damaged.

    Why: Damaged bytes crash the host or spoil the run silently.

    Remedy: Check length and a mark or sum before use, and return fmi2Error

    Example: memcpy() of whatever comes.
    """
    _needs_bytes(bench)
    with bench.held() as instance:
        data = _bytes(bench, instance)
    for what, spoiled in _cut(data).items():
        if (yield from _taken(bench, what, spoiled)):
            yield f"{what}: deserialized, set and stepped without a word"
    for what, spoiled in _noise(data).items():
        # Nothing demands a checksum, so this is worth knowing and no breach.
        if (yield from _taken(bench, what, spoiled)):
            bench.notes.append(f"{what} in place of a serialized state is taken for one")
    yield from _flipped(bench, data)


def _taken(bench: Bench, what: str, data: bytes) -> Generator[str, None, bool]:
    """Whether bytes that are no state go through as one; lines if they do harm."""
    instance = bench.ready()
    bench.run(instance, last=_POINT)
    statuses = []
    bench.library.probe = "damaged bytes"
    status, state = instance.deserialize(data)
    statuses.append(status)
    if status in (Status.OK, Status.WARNING):
        statuses.append(instance.set_state(state))
        # Refusing whatever comes next is as good: the state was not taken for one.
        with suppress(Violated):
            excite(instance, bench.description, _POINT)
        statuses.append(instance.step(bench.grid.time(_POINT), bench.grid.step))
    if Status.FATAL in statuses:
        yield f"{what}: fmi2Fatal, which ends all instances"
        return False
    demand(instance.reset(), f"fmi2Reset after {what}")
    yield from bench.compare(bench.run(bench.initialize(instance)), f"after {what} and fmi2Reset")
    instance.free()
    return all(status == Status.OK for status in statuses)


def _flipped(bench: Bench, data: bytes) -> Iterator[str]:
    """A flipped bit may give another state, but no harm (there need not be a checksum)."""
    instance = bench.fresh()
    for place in range(0, len(data), max(1, len(data) // 50)):
        spoiled = bytearray(data)
        spoiled[place] ^= 0x10
        bench.library.probe = "damaged bytes"
        status, state = instance.deserialize(bytes(spoiled))
        if status == Status.OK:
            status = instance.set_state(state)
            instance.step(bench.grid.time(_POINT), bench.grid.step)
            instance.free_state(state)
        if status == Status.FATAL:
            yield f"a flipped bit in byte {place}: fmi2Fatal, which ends all instances"
            return
        demand(instance.reset(), "fmi2Reset after a flipped bit")
    found = bench.run(bench.initialize(instance))
    yield from bench.compare(found, "after flipped bits and fmi2Reset")
    instance.free()
