"""Rules about instances: making, freeing, keeping them apart from each other and the process."""

from __future__ import annotations

import ctypes
import locale
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from congelation.conformance.bench import Bench, from_text
from congelation.conformance.instance import Instance
from congelation.conformance.job import Job
from congelation.conformance.rule import Level, NotApplicable, NotEvaluated, dynamic
from congelation.conformance.trajectory import Trajectory, demand, excite, first_difference, observe

__all__: list[str] = []

_WRONG_GUID = "{00000000-0000-0000-0000-000000000000}"
# Cycles of fmi2Instantiate and fmi2FreeInstance, after as many again have filled the caches.
_CYCLES = 1000
_WARM_UP = 200
# Bytes for each cycle. Below the finer bound growth drowns in the allocator's own; above the
# coarse one a sweep of ten thousand runs in one process ends in the swap.
_FINE_LEAK = 1024.0
_COARSE_LEAK = 64 * 1024.0


@dynamic("FMI2-INST-01", "2.1.5", Level.WARNING)
def wrong_guid(bench: Bench) -> Iterator[str]:
    """fmi2Instantiate returns a null pointer for a GUID other than that of modelDescription.xml.

    Standard: "Argument fmuGUID is used to check that the modelDescription.xml file is compatible
    with the C code of the FMU."

    Why: An XML of another version has other value references.

    Remedy: Compare the GUID and return a null pointer if it differs

    Example: An FMU that accepts any GUID.
    """
    with bench.probing("another GUID"):
        instance = bench.attempt(guid=_WRONG_GUID)
    if instance.component is not None:
        instance.free()
        yield f"an instance was made for the GUID {_WRONG_GUID}"


@dynamic("FMI2-INST-02", "2.1.5", Level.VIOLATION)
def explained_refusal(bench: Bench) -> Iterator[str]:
    """A failed instantiation calls the logger with the reason.

    Standard: "If a null pointer is returned, then instantiation failed. In that case,
    functions->logger is called with detailed information about the reason."

    Why: Without the reason nobody can correct it.

    Remedy: Call the logger before returning a null pointer

    Example: return NULL; without a message.
    """
    with bench.probing("another GUID"):
        instance = bench.attempt(guid=_WRONG_GUID)
    if instance.component is not None:
        instance.free()
        raise NotApplicable("a wrong GUID is accepted, see FMI2-INST-01")
    if not any(message.text for message in instance.messages):
        yield "fmi2Instantiate returned a null pointer and logged nothing"


@dynamic("FMI2-INST-03", "2.1.5, 2.1.8", Level.VIOLATION)
def null_pointers(bench: Bench) -> Iterator[str]:
    """fmi2FreeInstance and fmi2FreeFMUstate ignore a null pointer.

    Standard: "If a null pointer is provided for c, the function call is ignored"

    Why: Hosts free what they have, also after a failure.

    Remedy: Return at once for a null pointer

    Example: ((Model *)c)->name without a test.
    """
    bench.library.probe = "a null pointer"
    bench.library.call("FreeInstance", None)
    if bench.description.flag("canGetAndSetFMUstate"):
        with bench.held() as instance:
            status = instance.free_state(ctypes.c_void_p())
            if status != 0:
                yield f"fmi2FreeFMUstate returned {status} for a null pointer"
    yield from ()


@dynamic("FMI2-INST-04", "4.2.4", Level.VIOLATION)
def free_anywhere(bench: Bench) -> Iterator[str]:
    """An instance can be freed in every state, and the next one is as good as new.

    Standard: fmi2FreeInstance is allowed in every state but stepInProgress; an FMU "can be
    instantiated many times"

    Why: A host may give up at any point, and starts anew.

    Remedy: Free what there is, and keep nothing in globals

    Example: A second instance that finds the globals of the first.
    """
    for _ in range(2):
        bench.alone()
    bench.fresh().free()
    bench.begin(bench.fresh()).free()
    bench.ready().free()
    stopped = bench.ready()
    bench.run(stopped)
    demand(stopped.terminate(), "fmi2Terminate")
    stopped.free()
    yield from bench.compare(bench.alone(), "after freeing in every state")


def _interleaved(bench: Bench, instances: list[tuple[Bench, Instance, float]]) -> list[Trajectory]:
    """Step several instances in turn; each with the inputs of its own phase."""
    rows = [[observe(i, b.description)] for b, i, _ in instances]
    for point in range(bench.grid.steps):
        for b, instance, phase in instances:
            excite(instance, b.description, point, phase)
        for (b, instance, _), column in zip(instances, rows, strict=True):
            time = b.grid.time(point)
            demand(instance.step(time, b.grid.time(point + 1) - time), "fmi2DoStep")
            column.append(observe(instance, b.description))
    return [Trajectory((), tuple(column)) for column in rows]


def _repeatable(bench: Bench) -> None:
    if not bench.job.able.repeats:
        raise NotEvaluated("two equal runs differ, see FMI2-STEP-07")


def _named(found: Trajectory, model: Trajectory) -> Trajectory:
    return Trajectory(model.names, found.rows)


def _only_one(bench: Bench) -> None:
    if bench.alone_only:
        if not bench.description.flag("canBeInstantiatedOnlyOncePerProcess"):
            raise NotEvaluated(bench.job.able.beside)
        raise NotApplicable("canBeInstantiatedOnlyOncePerProcess is true")


@dynamic("FMI2-INST-05", "2.1.5, 4.3.1", Level.VIOLATION)
def interleaved(bench: Bench) -> Iterator[str]:
    """Instances that run interleaved in one process do what each does alone.

    Standard: "An FMU can be instantiated many times (provided capability flag
    canBeInstantiatedOnlyOncePerProcess = false)."

    Why: A system may hold a model twice.

    Remedy: Keep all data in the component, or set canBeInstantiatedOnlyOncePerProcess

    Example: static double x;
    """
    _only_one(bench)
    phases = (0.0, 1.0, 2.0)
    _repeatable(bench)
    expected = [bench.alone(phase) for phase in phases]
    together = [(bench, bench.ready(f"number {p:g}", phase=p), p) for p in phases]
    for phase, found, model in zip(phases, _interleaved(bench, together), expected, strict=True):
        difference = first_difference(_named(found, model), model)
        if difference is not None:
            yield f"instance {phase:g} of {len(phases)} together: {difference}"
    for _, instance, _ in together:
        instance.free()


@dynamic("FMI2-INST-06", "2.1", Level.ROBUSTNESS)
def two_models(bench: Bench) -> Iterator[str]:
    """Next to another FMU in the same process the FMU does what it does alone, and so does the
    other.

    Standard: nothing; a master loads all FMUs of a system.

    Why: A setting of the process or a clash of symbols changes the other FMU.

    Remedy: Keep data in the component and symbols local

    Example: Two FMUs that share an environment variable.
    """
    _only_one(bench)
    _repeatable(bench)
    scratch = Path(bench.job.scratch) / "companion"
    scratch.mkdir()
    able = replace(bench.job.able, reference="")
    other = Bench(Job(bench.job.companion, bench.job.directory, str(scratch), able=able))
    benches = (bench, other)
    expected = [from_text(bench.elsewhere("alone", directory=b.directory)) for b in benches]
    together = [(b, b.ready(name), 0.0) for b, name in zip(benches, ("one", "other"), strict=True)]
    for b, found, model in zip(benches, _interleaved(bench, together), expected, strict=True):
        difference = first_difference(_named(found, model), model)
        if difference is not None:
            label = b.description.model_name
            yield f"{label} together with the other FMU: {difference}"
    for _, instance, _ in together:
        instance.free()


def _surroundings() -> dict[str, object]:
    """Settings of the process that an FMU must leave alone."""
    process = ctypes.CDLL(None)
    return {
        "working directory": os.getcwd(),
        "environment": _environment(process),
        "locale": locale.setlocale(locale.LC_ALL),
        "rounding mode": process.fegetround(),
        "umask": _umask(),
    }


def _environment(process: ctypes.CDLL) -> frozenset[bytes]:
    """The environment as C sees it; os.environ is a copy from the start of the process."""
    pointer = ctypes.POINTER(ctypes.c_char_p).in_dll(process, "environ")
    entries = set()
    position = 0
    while (entry := pointer[position]) is not None:
        entries.add(entry)
        position += 1
    return frozenset(entries)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@dynamic("FMI2-INST-07", "2.1", Level.ROBUSTNESS)
def global_settings(bench: Bench) -> Iterator[str]:
    """Running the FMU changes no setting of the process: directory, environment, locale, rounding,
    umask.

    Standard: nothing; a host needs its own settings.

    Why: A changed working directory or rounding mode changes the host's results.

    Remedy: Restore what was changed before returning

    Example: chdir() in fmi2Instantiate.
    """
    before = _surroundings()
    bench.alone()
    after = _surroundings()
    for name, value in before.items():
        if after[name] != value:
            yield f"the {name} changed" + ("" if name == "environment" else f" to {after[name]!r}")


def _resident() -> float:
    """Memory of this process that has no file behind it, in bytes."""
    path = Path("/proc/self/statm")
    if not path.exists():
        raise NotApplicable("the memory of a process is read from /proc, which is missing here")
    fields = path.read_text(encoding="ascii").split()
    return (float(fields[1]) - float(fields[2])) * os.sysconf("SC_PAGE_SIZE")


def _growth(bench: Bench) -> float:
    """Bytes by which the process grows with each instance made and freed."""
    for _ in range(_WARM_UP):
        bench.fresh().free()
    before = _resident()
    for _ in range(_CYCLES):
        bench.fresh().free()
    return (_resident() - before) / _CYCLES


@dynamic("FMI2-INST-08", "2.1.5", Level.ROBUSTNESS, time_factor=4.0)
def bounded_memory(bench: Bench) -> Iterator[str]:
    """A thousand instances made and freed leave less than 64 kB behind each.

    Standard: "frees all the allocated memory"; the measured bound is this check's.

    Why: A sweep of many runs in one process ends without memory.

    Remedy: Free in fmi2FreeInstance what was allocated

    Example: A megabyte for each instance.
    """
    growth = _growth(bench)
    bench.notes.append(f"{growth / 1024.0:.1f} kB for each instance made and freed")
    if growth > _COARSE_LEAK:
        yield f"each of {_CYCLES} instances left {growth / 1024.0:.1f} kB behind"


@dynamic("FMI2-INST-09", "2.1.5", Level.ROBUSTNESS, time_factor=4.0)
def no_leak(bench: Bench) -> Iterator[str]:
    """A thousand instances that leave less than 64 kB behind each leave less than 1 kB.

    Standard: "frees all the allocated memory"; the measured bound is this check's.

    Why: A sweep of many runs in one process ends without memory.

    Remedy: Free in fmi2FreeInstance what was allocated

    Example: A strdup() of the instance's name that is not freed.
    """
    growth = _growth(bench)
    if _FINE_LEAK < growth <= _COARSE_LEAK:
        yield f"each of {_CYCLES} instances left {growth / 1024.0:.1f} kB behind"


def _open_files() -> int:
    folder = Path("/proc/self/fd")
    if not folder.is_dir():
        raise NotApplicable("open files are counted in /proc, which is missing here")
    return len(list(folder.iterdir()))


@dynamic("FMI2-INST-10", "2.1.5", Level.VIOLATION)
def no_open_files(bench: Bench) -> Iterator[str]:
    """fmi2FreeInstance closes every file that the instance opened.

    Standard: fmi2FreeInstance frees "all the allocated memory and other resources"

    Why: A process may open some thousand files.

    Remedy: Close in fmi2FreeInstance what was opened

    Example: fopen() without fclose().
    """
    bench.alone()
    before = _open_files()
    for _ in range(10):
        bench.alone()
    if (left := _open_files() - before) > 0:
        yield f"{left} files are still open after 10 instances"
