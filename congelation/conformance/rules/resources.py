"""Rules about fmuResourceLocation: every form of a file URI (section 2.1.5, RFC 3986)."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from congelation.conformance.bench import Bench
from congelation.conformance.rule import NotApplicable, Rule, dynamic
from congelation.conformance.trajectory import demand

__all__ = ["RULES"]


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


@dynamic("FMI2-URI-01", "2.1.5", bare=True)
def empty_authority(bench: Bench) -> Iterator[str]:
    """The resource location may have the form file:///path."""
    yield from _run_with(bench, f"file://{_plain_path(bench)}")


@dynamic("FMI2-URI-02", "2.1.5")
def no_authority(bench: Bench) -> Iterator[str]:
    """The resource location may have the form file:/path."""
    yield from _run_with(bench, f"file:{_plain_path(bench)}")


@dynamic("FMI2-URI-03", "2.1.5")
def local_authority(bench: Bench) -> Iterator[str]:
    """The resource location may have the form file://localhost/path."""
    yield from _run_with(bench, f"file://localhost{_plain_path(bench)}")


@dynamic("FMI2-URI-04", "2.1.5")
def space(bench: Bench) -> Iterator[str]:
    """A space in the path, written %20 in the resource location, is understood."""
    yield from _run_with(bench, _moved(bench, "with a space").as_uri())


@dynamic("FMI2-URI-05", "2.1.5")
def percent_encoding(bench: Bench) -> Iterator[str]:
    """Any character of the path may be percent-encoded, in UTF-8."""
    yield from _run_with(bench, _moved(bench, "Größe θ #1+2%").as_uri())


RULES: tuple[Rule, ...] = (empty_authority, no_authority, local_authority, space, percent_encoding)
