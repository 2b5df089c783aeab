"""Rules about the shared library: what it exports, how it is loaded, and in which host."""

from __future__ import annotations

from collections.abc import Iterator

from congelation.conformance.bench import Bench
from congelation.conformance.binding import EXCHANGE_FUNCTIONS, FUNCTIONS
from congelation.conformance.host import loads_bare, run_in_host
from congelation.conformance.rule import Level, dynamic
from congelation.conformance.trajectory import demand, first_difference

__all__: list[str] = []

# A host that dies in more than one run of five is found with a probability of 0.7 and more.
_HOST_RUNS = 5


@dynamic("FMI2-LIB-01", "2.3, 4.2.4", Level.VIOLATION, needs="library")
def exports(bench: Bench) -> Iterator[str]:
    """The shared library can be loaded and exports every function of its kinds.

    Standard: "it is required that all functions specified for Model Exchange and/or Co-Simulation
    are present, even if they are only needed for capabilities that the FMU does not support"

    Why: A host looks up every function when it loads the library.

    Remedy: Export every function of the interface from a library that can be loaded

    Example: A library without fmi2CancelStep.
    """
    for name in FUNCTIONS:
        if not bench.library.has(name):
            yield f"fmi2{name} is not exported"
    for name in EXCHANGE_FUNCTIONS if bench.description.exchange_flags else ():
        if not bench.exchange_library.has(name):
            yield f"fmi2{name} is not exported"


@dynamic("FMI2-LIB-02", "2.1.4", Level.VIOLATION, needs="library")
def versions(bench: Bench) -> Iterator[str]:
    """fmi2GetVersion returns "2.0".

    Standard: "The standard header file as documented in this specification has version 2.0"

    Why: A host chooses the interface by it.

    Remedy: Return fmi2Version of the header

    Example: A library that returns "2.1".
    """
    found = bench.library.call("GetVersion")
    if found != b"2.0":
        yield f"fmi2GetVersion returns {found!r}"
    platform = bench.library.call("GetTypesPlatform")
    if platform != b"default":
        bench.notes.append(f"fmi2GetTypesPlatform returns {platform!r}; 'default' was assumed")


@dynamic("FMI2-LIB-03", "4.2.4", Level.VIOLATION, needs="library", owns=("fmi2Terminate",))
def plain_run(bench: Bench) -> Iterator[str]:
    """With its start values the FMU initializes, steps, terminates and is freed.

    Standard: the table of allowed calls: with the start values of the XML every call of a plain
    run "is allowed in the corresponding state"

    Why: Nothing else works if this does not.

    Remedy: Make a run from startTime with the default start values succeed

    Example: An FMU that fails in fmi2ExitInitializationMode.
    """
    bench.description = bench.description.at_rest()
    bench.alone()
    yield from ()


@dynamic("FMI2-LIB-04", "2.1.5", Level.ROBUSTNESS)
def reload(bench: Bench) -> Iterator[str]:
    """The library can be unloaded after fmi2FreeInstance, loaded again, and behaves the same.

    Standard: nothing; a host that runs many FMUs unloads libraries.

    Why: A second load in one process is common in studies.

    Remedy: Leave nothing behind that the next load stumbles on

    Example: A constructor that may run only once.
    """
    first = bench.reference
    bench.alone()
    bench.library.unload()
    library = bench.load()
    instance = bench.initialize(bench.fresh(library=library))
    difference = first_difference(bench.run(instance), first)
    instance.free()
    if bench.job.able.repeats and difference is not None:
        yield f"after unloading and loading again: {difference}"


@dynamic("FMI2-LIB-05", "2.1.5", Level.ROBUSTNESS, ends_normally=True)
def clean_exit(bench: Bench) -> Iterator[str]:
    """A process that ran and freed the FMU ends normally.

    Standard: nothing; a host has to end with its own exit code.

    Why: A crash at exit hides the result of the run.

    Remedy: Stop threads and free globals in fmi2FreeInstance, not at exit

    Example: A destructor of the library that aborts.
    """
    instance = bench.ready()
    bench.run(instance)
    demand(instance.terminate(), "fmi2Terminate")
    instance.free()
    yield from ()


@dynamic("FMI2-HOST-01", "2.1, 2.3", Level.ROBUSTNESS)
def c_host(bench: Bench) -> Iterator[str]:
    """In a host written in C the FMU gives the same outputs, and the host ends normally.

    Standard: nothing; the host may be written in any language.

    Why: An FMU made with one host in mind may need its symbols.

    Remedy: Need nothing that only one host has

    Example: A library that looks up Python's functions in the host.
    """
    for _ in range(_HOST_RUNS):
        yield from run_in_host(bench)


@dynamic("FMI2-HOST-02", "2.3", Level.WARNING, needs="library")
def self_contained(bench: Bench) -> Iterator[str]:
    """A bare host can load the library, or documentation/externalDependencies tells why not.

    Standard: "FMUs should contain all resources that are required to load and execute a shared
    library"; otherwise "documentation/externalDependencies.{txt|html} should be present"

    Why: A library that is missing elsewhere ends the import.

    Remedy: Ship the libraries it needs beside it (RPATH=$ORIGIN), or document them in
    documentation/externalDependencies.txt

    Example: A library linked to libgfortran.so.3.
    """
    trouble = loads_bare(bench)
    if trouble is None:
        return
    names = ("externalDependencies.txt", "externalDependencies.html")
    if not any((bench.directory / "documentation" / name).is_file() for name in names):
        yield f"{trouble}, and there is no documentation/externalDependencies.txt or .html"
    else:
        bench.notes.append(f"needs what documentation/externalDependencies says ({trouble})")
