"""Rules about instances: making, freeing, keeping them apart from each other and the process.

At the end, their fmuResourceLocation: every form of a file URI (section 2.1.5, RFC 3986).
"""

from __future__ import annotations

import ctypes
import locale
import os
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

from congelation.conformance.bench import Bench, from_text
from congelation.conformance.instance import Instance
from congelation.conformance.job import Job
from congelation.conformance.rule import Level, NotApplicable, NotEvaluated, dynamic, require
from congelation.conformance.trajectory import Trajectory, demand, excite, first_difference, observe

__all__: list[str] = []

_WRONG_GUID = "{00000000-0000-0000-0000-000000000000}"
# Cycles of fmi2Instantiate and fmi2FreeInstance, after some have filled the caches. What the
# allocator itself keeps, up to a megabyte, is to be less than the bound allows for all cycles: the
# coarse bound needs few of them.
_CYCLES_COARSE = 100
_CYCLES_FINE = 1000
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
    bench.library.probe = "another GUID"
    instance = bench.fresh(guid=_WRONG_GUID, refusable=True)
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
    bench.library.probe = "another GUID"
    instance = bench.fresh(guid=_WRONG_GUID, refusable=True)
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


def _interleaved(
    bench: Bench,
    instances: list[tuple[Bench, Instance, float]],
    alone: list[Trajectory],
    labels: Iterable[str],
) -> Iterator[str]:
    """Step several instances in turn, each with the inputs of its own phase, and free them.

    A line for each that does something else than alone.
    """
    rows = [[observe(i, b.description)] for b, i, _ in instances]
    for point in range(bench.grid.steps):
        for b, instance, phase in instances:
            excite(instance, b.description, point, phase)
        for (b, instance, _), column in zip(instances, rows, strict=True):
            time = b.grid.time(point)
            demand(instance.step(time, b.grid.time(point + 1) - time), "fmi2DoStep")
            column.append(observe(instance, b.description))
    for label, column, expected in zip(labels, rows, alone, strict=True):
        difference = first_difference(Trajectory(expected.names, tuple(column)), expected)
        if difference is not None:
            yield f"{label}: {difference}"
    for _, instance, _ in instances:
        instance.free()


def _require_several(bench: Bench) -> None:
    """Raise where there can be no second instance, or runs cannot be compared."""
    if bench.alone_only:
        if not bench.description.flag("canBeInstantiatedOnlyOncePerProcess"):
            raise NotEvaluated(bench.job.able.beside)
        raise NotApplicable("canBeInstantiatedOnlyOncePerProcess is true")
    if not bench.job.able.repeats:
        raise NotEvaluated("two equal runs differ, see FMI2-STEP-07")


@dynamic("FMI2-INST-05", "2.1.5, 4.3.1", Level.VIOLATION)
def interleaved(bench: Bench) -> Iterator[str]:
    """Instances that run interleaved in one process do what each does alone.

    Standard: "An FMU can be instantiated many times (provided capability flag
    canBeInstantiatedOnlyOncePerProcess = false)."

    Why: A system may hold a model twice.

    Remedy: Keep all data in the component, or set canBeInstantiatedOnlyOncePerProcess

    Example: static double x;
    """
    _require_several(bench)
    phases = (0.0, 1.0, 2.0)
    alone = [bench.alone(phase) for phase in phases]
    together = [(bench, bench.ready(f"number {p:g}", phase=p), p) for p in phases]
    labels = (f"instance {phase:g} of {len(phases)} together" for phase in phases)
    yield from _interleaved(bench, together, alone, labels)


@dynamic("FMI2-INST-06", "2.1", Level.ROBUSTNESS)
def two_models(bench: Bench) -> Iterator[str]:
    """Next to another FMU in the same process the FMU does what it does alone, and so does the
    other.

    Standard: nothing; a master loads all FMUs of a system.

    Why: A setting of the process or a clash of symbols changes the other FMU.

    Remedy: Keep data in the component and symbols local

    Example: Two FMUs that share an environment variable.
    """
    _require_several(bench)
    scratch = Path(bench.job.scratch) / "companion"
    scratch.mkdir()
    able = replace(bench.job.able, reference="")
    other = Bench(Job(bench.job.companion, bench.job.directory, str(scratch), able=able))
    benches = (bench, other)
    alone = [from_text(bench.elsewhere("alone", directory=b.directory)) for b in benches]
    together = [(b, b.ready(name), 0.0) for b, name in zip(benches, ("one", "other"), strict=True)]
    labels = (f"{b.description.model_name} together with the other FMU" for b in benches)
    yield from _interleaved(bench, together, alone, labels)


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
    require(path.exists(), "the memory of a process is read from /proc, which is missing here")
    fields = path.read_text(encoding="ascii").split()
    return (float(fields[1]) - float(fields[2])) * os.sysconf("SC_PAGE_SIZE")


def _growth(bench: Bench, cycles: int) -> float:
    """Bytes by which the process grows with each instance made and freed."""
    for _ in range(_WARM_UP):
        bench.fresh().free()
    before = _resident()
    for _ in range(cycles):
        bench.fresh().free()
    return (_resident() - before) / cycles


@dynamic("FMI2-INST-08", "2.1.5", Level.ROBUSTNESS, time_factor=4.0)
def bounded_memory(bench: Bench) -> Iterator[str]:
    """A hundred instances made and freed leave less than 64 kB behind each.

    Standard: "frees all the allocated memory"; the measured bound is this check's.

    Why: A sweep of many runs in one process ends without memory.

    Remedy: Free in fmi2FreeInstance what was allocated

    Example: A megabyte for each instance.
    """
    growth = _growth(bench, _CYCLES_COARSE)
    bench.notes.append(f"{growth / 1024.0:.1f} kB for each instance made and freed")
    if growth > _COARSE_LEAK:
        yield f"each of {_CYCLES_COARSE} instances left {growth / 1024.0:.1f} kB behind"


@dynamic("FMI2-INST-09", "2.1.5", Level.ROBUSTNESS, time_factor=4.0)
def no_leak(bench: Bench) -> Iterator[str]:
    """A thousand instances that leave less than 64 kB behind each leave less than 1 kB.

    Standard: "frees all the allocated memory"; the measured bound is this check's.

    Why: A sweep of many runs in one process ends without memory.

    Remedy: Free in fmi2FreeInstance what was allocated

    Example: A strdup() of the instance's name that is not freed.
    """
    growth = _growth(bench, _CYCLES_FINE)
    if _FINE_LEAK < growth <= _COARSE_LEAK:
        yield f"each of {_CYCLES_FINE} instances left {growth / 1024.0:.1f} kB behind"


def _open_files() -> int:
    folder = Path("/proc/self/fd")
    require(folder.is_dir(), "open files are counted in /proc, which is missing here")
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


# -- resources -----------------------------------------------------------------------------------


def _run_with(bench: Bench, uri: str) -> Iterator[str]:
    """Run with a resource location; the run has to be the same as with the plain one."""
    instance = bench.initialize(bench.fresh(uri=uri))
    found = bench.run(instance)
    demand(instance.terminate(), "fmi2Terminate")
    instance.free()
    yield from bench.compare(found, uri)


def _plain_path(bench: Bench) -> str:
    """The resources directory as the path of a URI."""
    return quote(str(bench.directory / "resources"))


def _moved(bench: Bench, name: str) -> Path:
    """A copy of the resources in a directory whose name has to be percent-encoded."""
    source = bench.directory / "resources"
    require(source.is_dir(), "the FMU has no resources")
    target = Path(bench.job.scratch) / name / "resources"
    shutil.copytree(source, target)
    return target


@dynamic("FMI2-URI-01", "2.1.5", Level.VIOLATION, needs="library")
def empty_authority(bench: Bench) -> Iterator[str]:
    """The resource location may have the form file:///path.

    Standard: "Mandatory: file with absolute path (either including or omitting the authority
    component)"

    Why: Hosts write file:///path.

    Remedy: Parse the URI by RFC 3986

    Example: Taking "file:" off and opening "///path" with a library that refuses it.
    """
    yield from _run_with(bench, f"file://{_plain_path(bench)}")


@dynamic("FMI2-URI-02", "2.1.5", Level.VIOLATION)
def no_authority(bench: Bench) -> Iterator[str]:
    """The resource location may have the form file:/path.

    Standard: "Mandatory: file with absolute path (either including or omitting the authority
    component)"

    Why: Some hosts write file:/path.

    Remedy: Parse the URI by RFC 3986

    Example: Taking seven characters off whatever comes.
    """
    yield from _run_with(bench, f"file:{_plain_path(bench)}")


@dynamic("FMI2-URI-03", "2.1.5", Level.ROBUSTNESS)
def local_authority(bench: Bench) -> Iterator[str]:
    """The resource location may have the form file://localhost/path.

    Standard: RFC 3986, section 3.2.2: no authority, an empty host and "localhost" mean the same
    machine; no host is known that writes it.

    Why: The form is legal.

    Remedy: Parse the URI by RFC 3986

    Example: Opening "localhost/path".
    """
    yield from _run_with(bench, f"file://localhost{_plain_path(bench)}")


@dynamic("FMI2-URI-04", "2.1.5", Level.VIOLATION)
def space(bench: Bench) -> Iterator[str]:
    """A space in the path, written %20 in the resource location, is understood.

    Standard: "fmuResourceLocation is a URI according to the IETF RFC3986 syntax", where a space
    is written %20

    Why: User folders have spaces in their names.

    Remedy: Decode %XX in the path

    Example: Opening "with%20space".
    """
    yield from _run_with(bench, _moved(bench, "with a space").as_uri())


@dynamic("FMI2-URI-05", "2.1.5", Level.VIOLATION)
def percent_encoding(bench: Bench) -> Iterator[str]:
    """Any character of the path may be percent-encoded, in UTF-8.

    Standard: "fmuResourceLocation is a URI according to the IETF RFC3986 syntax", where any octet
    may be written %XX

    Why: User names have letters beyond ASCII.

    Remedy: Decode every %XX as UTF-8

    Example: Decoding %20 alone.
    """
    yield from _run_with(bench, _moved(bench, "Größe θ #1+2%").as_uri())
