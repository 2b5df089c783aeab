"""The test FMU: compiled once, and with the mutation that is asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Lock

import lag
import pytest

from congelation.conformance.checker import Checker


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], bytes]:
    """The shared library with a mutation, or "" for the correct one."""
    folder = tmp_path_factory.mktemp("libraries")
    compiling = Lock()

    def compiled(mutation: str = "") -> bytes:
        with compiling:
            return lag.compiled(folder, mutation)

    return compiled


@pytest.fixture(scope="session")
def correct(library: Callable[[str], bytes], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The correct FMU."""
    return lag.build(tmp_path_factory.mktemp("correct"), library(""))


@pytest.fixture(scope="module", autouse=True)
def checking(correct: Path) -> Iterator[None]:
    """A check under way all the time: what forks processes for it does so for all in a module."""
    with Checker(correct):
        yield
