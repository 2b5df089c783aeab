"""Rules about the complete FMU state (section 2.1.8): getting, setting, freeing, serializing it."""

from __future__ import annotations

import random
from collections.abc import Generator, Iterator
from contextlib import suppress
from ctypes import c_void_p

from congelation.conformance.bench import Bench, from_text
from congelation.conformance.binding import Status
from congelation.conformance.description import Value
from congelation.conformance.instance import Instance
from congelation.conformance.probe import shifted
from congelation.conformance.rule import STATE_NOT_RESTORED, Level, Violated, dynamic
from congelation.conformance.trajectory import (
    demand,
    excitation,
    excite,
    first_difference,
    inputs,
    same,
)

__all__ = ["restore", "save"]

# Communication point at which states are serialized, and bytes behind the buffer that are watched.
_POINT, _GUARD = 4, 64


def save(instance: Instance, where: str = "") -> c_void_p:
    """Get the FMU state into a new handle."""
    status, state = instance.get_state()
    demand(status, f"fmi2GetFMUstate{where}")
    return state


def restore(instance: Instance, state: c_void_p, where: str = "") -> None:
    """Set the FMU state."""
    demand(instance.set_state(state), f"fmi2SetFMUstate{where}")


@dynamic("FMI2-FMUSTATE-01", "2.1.8", Level.VIOLATION, owns=(STATE_NOT_RESTORED,))
def replay(bench: Bench) -> Iterator[str]:
    """From a state set again the simulation repeats itself, to the last bit.

    Standard: fmi2SetFMUstate "copies the content of the previously copied FMUstate back and uses
    it as actual new FMU state"

    Why: Rollback repeats a step.

    Remedy: Save everything that a simulation needs to go on

    Example: A state without the integrator's history.
    """
    bench.require_flag("canGetAndSetFMUstate")
    with bench.held() as instance:
        bench.run(instance, last=4)
        state = save(instance)
        bench.run(instance, first=4, phase=1.0)
        for times in ("once", "twice"):
            restore(instance, state)
            yield from bench.compare(bench.run(instance, first=4), f"after setting it {times}")
        demand(instance.free_state(state), "fmi2FreeFMUstate")


@dynamic("FMI2-FMUSTATE-02", "2.1.8", Level.VIOLATION)
def several_handles(bench: Bench) -> Iterator[str]:
    """Several saved states are independent of each other and of the running instance.

    Standard: fmi2GetFMUstate "makes a copy of the internal FMU state"; after fmi2SetFMUstate "The
    FMUstate copy still exists"

    Why: Iterating masters hold several states.

    Remedy: Copy, and do not share

    Example: One buffer for all states.
    """
    bench.require_flag("canGetAndSetFMUstate")
    points = (0, 3, 6, 9)
    with bench.held() as instance:
        handles: dict[int, c_void_p] = {}
        for point in points:
            bench.run(instance, first=max(point - 3, 0), last=point, quiet=True)
            handles[point] = save(instance)
        for point in (6, 0, 9, 3):
            restore(instance, handles[point])
            yield from bench.compare(bench.run(instance, first=point), f"from state {point}")
        demand(instance.free_state(handles[3]), "fmi2FreeFMUstate")
        restore(instance, handles[6])
        yield from bench.compare(bench.run(instance, first=6), "after freeing another state")
        for point in (0, 6, 9):
            demand(instance.free_state(handles[point]), "fmi2FreeFMUstate")


@dynamic("FMI2-FMUSTATE-03", "2.1.8", Level.VIOLATION)
def handle_reused(bench: Bench) -> Iterator[str]:
    """fmi2GetFMUstate into a former handle leaves the new state in it.

    Standard: "If *FMUstate != NULL, then *FMUstate points to a previously returned FMUstate"; a
    note: the memory is reused "with the actual FMUstate"

    Why: Masters save into one handle at each step.

    Remedy: Write the new state into the former handle

    Example: A former handle that keeps the old state.
    """
    bench.require_flag("canGetAndSetFMUstate")
    with bench.held() as instance:
        state = save(instance)
        bench.run(instance, last=5)
        status, state = instance.get_state(state)
        demand(status, "fmi2GetFMUstate into a former handle")
        bench.run(instance, first=5)
        restore(instance, state)
        yield from bench.compare(bench.run(instance, first=5), "from a handle used again")
        demand(instance.free_state(state), "fmi2FreeFMUstate")


@dynamic("FMI2-FMUSTATE-04", "2.1.8", Level.VIOLATION)
def freed_is_null(bench: Bench) -> Iterator[str]:
    """fmi2FreeFMUstate returns a null pointer in its argument.

    Standard: "The function returns a null pointer in argument FMUstate."

    Why: A second free does no harm then.

    Remedy: Set *FMUstate to NULL

    Example: A freed pointer that is left.
    """
    bench.require_flag("canGetAndSetFMUstate")
    with bench.held() as instance:
        state = save(instance)
        demand(instance.free_state(state), "fmi2FreeFMUstate")
        if state.value is not None:
            yield "the argument of fmi2FreeFMUstate is not null afterwards"


@dynamic("FMI2-FMUSTATE-05", "2.1.8", Level.VIOLATION)
def holds_inputs_and_parameters(bench: Bench) -> Iterator[str]:
    """The state holds the inputs and the tunable parameters.

    Standard: the state consists of "all values that are needed to continue a simulation",
    "especially of [..] parameter values, input values"

    Why: A repeated step uses the same inputs.

    Remedy: Save inputs and parameters too

    Example: A state without inputs.
    """
    bench.require_flag("canGetAndSetFMUstate")
    description = bench.description
    with bench.held() as instance:
        bench.run(instance, last=3)
        excite(instance, description, 3)
        state = save(instance)
        expected = _untouched(bench, instance)
        restore(instance, state)
        other: dict[int, Value] = {}
        for v in inputs(description):
            value = shifted(v, excitation(v, 3), description)
            other |= {} if value is None else {v.index: value}
        excite(instance, description, 3, instead=other)
        for v in description.variables:
            if v.causality == "parameter" and v.variability == "tunable" and v.start is not None:
                value = shifted(v, v.start, description)
                if value is not None:
                    instance.set(v.base, [v.reference], [value])
        restore(instance, state)
        found = _untouched(bench, instance)
        demand(instance.free_state(state), "fmi2FreeFMUstate")
    if not all(map(same, found, expected)):
        yield "a step from the state set again differs after inputs or tunable parameters were set"


def _untouched(bench: Bench, instance: Instance) -> list[Value]:
    """All values after one step, nothing set before it."""
    time = bench.grid.time(3)
    demand(instance.step(time, bench.grid.time(4) - time), "fmi2DoStep")
    # Nothing is excited between 4 and 4: this only reads.
    return list(bench.run(instance, first=4, last=4).rows[0])


@dynamic("FMI2-FMUSTATE-06", "2.1.8, 4.2.4", Level.VIOLATION)
def holds_the_mode(bench: Bench) -> Iterator[str]:
    """A state can be saved in "instantiated", Initialization Mode and stepComplete, and leads back
    there.

    Standard: the table allows fmi2GetFMUstate in instantiated, Initialization Mode and
    stepComplete; the state includes "FMU internal status information"

    Why: A host goes back behind initialization.

    Remedy: Save the mode too

    Example: A state without the mode.
    """
    bench.require_flag("canGetAndSetFMUstate")
    instance = bench.fresh()
    new = save(instance, ' in "instantiated"')
    begun = save(bench.begin(instance), " in Initialization Mode")
    demand(instance.leave(), "fmi2ExitInitializationMode")
    ready = save(instance, " in stepComplete")
    bench.run(instance)
    demand(instance.terminate(), "fmi2Terminate")
    restore(instance, ready, " in terminated")
    yield from bench.compare(bench.run(instance), "from a state before the first step")
    restore(instance, begun, " in stepComplete")
    demand(instance.leave(), "fmi2ExitInitializationMode after going back before it")
    yield from bench.compare(bench.run(instance), "from a state in Initialization Mode")
    restore(instance, new, " in stepComplete")
    found = bench.run(bench.initialize(instance))
    yield from bench.compare(found, 'from a state in "instantiated"')
    for state in (new, begun, ready):
        demand(instance.free_state(state), "fmi2FreeFMUstate")
    instance.free()


@dynamic("FMI2-FMUSTATE-07", "2.1.3, 2.1.8", Level.ROBUSTNESS)
def after_an_error(bench: Bench) -> Iterator[str]:
    """After a refused step the simulation goes on from a state saved before it.

    Standard: after fmi2Error "it can be tried to restart the simulation from a formerly stored
    FMU state".

    Why: A master goes on from there.

    Remedy: Take the instance's mode from the state

    Example: An error flag outside of the state.
    """
    bench.require_flag("canGetAndSetFMUstate")
    with bench.held() as instance:
        bench.run(instance, last=4)
        state = save(instance)
        excite(instance, bench.description, 4)
        status = instance.step(bench.grid.time(4), -bench.grid.step)
        restore(instance, state, f" after a step that returned {status}")
        yield from bench.compare(bench.run(instance, first=4), "after a refused step")
        demand(instance.free_state(state), "fmi2FreeFMUstate")


# -- as bytes ------------------------------------------------------------------------------------


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
def replay_from_bytes(bench: Bench) -> Iterator[str]:
    """From a deserialized state the same and another instance repeat the simulation, to the last
    bit.

    Standard: fmi2DeSerializeFMUstate "constructs a copy of the FMU state"

    Why: Checkpoints continue a run.

    Remedy: Serialize every bit that the state holds

    Example: Numbers as text of six digits.
    """
    bench.require_flag("canSerializeFMUstate")
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
    bench.require_flag("canSerializeFMUstate")
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
    bench.require_flag("canSerializeFMUstate")
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
    bench.require_flag("canSerializeFMUstate")
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
