"""Rules about the shared library: what it exports, how it is loaded, and in which host."""

from __future__ import annotations

from collections.abc import Iterator

from congelation.conformance.bench import Bench
from congelation.conformance.binding import FUNCTIONS
from congelation.conformance.host import loads_bare, run_in_host
from congelation.conformance.rule import Rule, dynamic
from congelation.conformance.trajectory import demand, first_difference

__all__ = ["RULES"]

# A host that dies in more than one run of five is found with a probability of 0.7 and more.
_HOST_RUNS = 5


@dynamic("FMI2-LIB-01", "2.3, 4.2.4", bare=True)
def exports(bench: Bench) -> Iterator[str]:
    """The shared library can be loaded and exports every function for co-simulation."""
    for name in FUNCTIONS:
        if not bench.library.has(name):
            yield f"fmi2{name} is not exported"


@dynamic("FMI2-LIB-02", "2.1.4", bare=True)
def versions(bench: Bench) -> Iterator[str]:
    """fmi2GetVersion returns "2.0" and fmi2GetTypesPlatform "default"."""
    for name, wanted in (("GetVersion", b"2.0"), ("GetTypesPlatform", b"default")):
        found = bench.library.call(name)
        if found != wanted:
            yield f"fmi2{name} returns {found!r}"


@dynamic("FMI2-LIB-03", "4.2.4", bare=True)
def plain_run(bench: Bench) -> Iterator[str]:
    """Instantiated with its start values, the FMU initializes, steps, terminates and is freed."""
    bench.alone()
    yield from ()


@dynamic("FMI2-LIB-04", "2.1.5", bare=True)
def reload(bench: Bench) -> Iterator[str]:
    """The library can be unloaded after fmi2FreeInstance, loaded again, and behaves the same."""
    first = bench.alone()
    bench.library.unload()
    library = bench.load()
    instance = bench.initialize(bench.fresh(library=library))
    difference = first_difference(bench.run(instance), first)
    instance.free()
    if difference is not None:
        yield f"after unloading and loading again: {difference}"


@dynamic("FMI2-LIB-05", "2.1.5", ends_normally=True)
def clean_exit(bench: Bench) -> Iterator[str]:
    """A process that ran and freed the FMU ends normally."""
    instance = bench.ready()
    bench.run(instance)
    demand(instance.terminate(), "fmi2Terminate")
    instance.free()
    yield from ()


@dynamic("FMI2-HOST-01", "2.1, 2.3")
def c_host(bench: Bench) -> Iterator[str]:
    """In a host written in C the FMU gives the same outputs, and the host ends normally."""
    for _ in range(_HOST_RUNS):
        yield from run_in_host(bench)


@dynamic("FMI2-HOST-02", "2.3")
def self_contained(bench: Bench) -> Iterator[str]:
    """A bare host can load the library, or documentation/externalDependencies tells why not."""
    trouble = loads_bare(bench)
    if trouble is None:
        return
    names = ("externalDependencies.txt", "externalDependencies.html")
    if not any((bench.directory / "documentation" / name).is_file() for name in names):
        yield f"{trouble}, and there is no documentation/externalDependencies.txt or .html"
    else:
        bench.notes.append(f"needs what documentation/externalDependencies says ({trouble})")


RULES: tuple[Rule, ...] = (
    exports,
    versions,
    plain_run,
    reload,
    clean_exit,
    c_host,
    self_contained,
)
