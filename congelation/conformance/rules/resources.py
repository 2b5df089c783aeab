"""Rules about fmuResourceLocation: every form of a file URI (section 2.1.5, RFC 3986)."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from congelation.conformance.bench import Bench
from congelation.conformance.rule import Level, NotApplicable, dynamic
from congelation.conformance.trajectory import demand

__all__: list[str] = []


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
    if not source.is_dir():
        raise NotApplicable("the FMU has no resources")
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
