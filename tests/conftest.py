"""Settings shared by all tests.

Property-based tests draw the same 25 examples in every run of `make test`, and 1,000 fresh ones in
`make fuzz`, which runs the tests marked ``fuzz``. Such a test sets no number of examples.
"""

import gc
import os
import signal
import sys
from functools import cache, partial
from pathlib import Path

import pytest
from hypothesis import settings

from congelation.cli import runs
from congelation.sweep import engine
from tests.studies import workers

# A package that is compiled anew in each of the thousands of processes costs minutes.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Matrices here are small: threads only wait for each other, and on a busy machine for minutes.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A shell starts what runs in its background with SIGINT ignored, and processes inherit that; tests
# that interrupt a command need it as it is in a foreground.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Imports and collecting make a million objects that stay: searches for garbage among them take a
# sixth of that time, and each later search would look through them anew.
gc.disable()

settings.register_profile(
    "repeatable", max_examples=25, derandomize=True, deadline=None, print_blob=True
)
settings.register_profile("fuzz", max_examples=1000, deadline=None, print_blob=True)
settings.load_profile("repeatable")  # --hypothesis-profile=fuzz takes its place


SLOW = (
    "benchmarks",
    "cli",
    "conformance",
    "cosim/test_built_fmus.py",
    "cosim/test_choice.py",
    "cosim/test_compiled.py",
    "cosim/test_couplings.py",
    "cosim/test_output.py",
    "design",
    "engines",
    "export/test_shipped_specs.py",
    "fmus",
    "fuzz",
    "native",
    "package",
    "report/test_browser.py",
    "report/test_figures.py",
    "scenario/test_shipped.py",
    "scenario/test_ssp.py",
    "sweep",
    "theory/test_extensions.py",
    "theory/test_weakened.py",
    "verify/test_certify.py",
    "verify/test_laws.py",
    "verify/test_measure.py",
)
"""Folders and files whose tests run processes, hosts, engines, all scenarios, or take some seconds
of processor time in all; `make test-fast` leaves them out."""


@cache
def is_slow(path: Path) -> bool:
    return any(path.is_relative_to(Path(__file__).parent / place) for place in SLOW)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Do not even import what `make test-fast` leaves out: that takes seconds in each process."""
    return True if config.option.markexpr == "not slow" and is_slow(collection_path) else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if is_slow(item.path):
            item.add_marker(pytest.mark.slow)
    # First, so that no long file is left for the end, when the other processes have nothing to do.
    items.sort(key=lambda item: not is_slow(item.path))


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Run the studies of a test in this process, unless it is marked ``workers``.

    A worker process takes most of a second to start, and most tests of `run` and `sweep` are about
    what comes before or after the runs.
    """
    place = partial(workers, item.get_closest_marker("workers") is not None)
    runs.Local = engine.Local = place  # type: ignore[assignment,misc]


_STATUS = pytest.StashKey[int]()


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    session.config.stash[_STATUS] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    """Leave without running the static destructors of the FMUs' libraries.

    PythonFMU's destructor reads memory that was freed just before; with the dozens of libraries
    that the tests load, that aborts one process in some dozens after all is said and done.
    """
    if _STATUS in config.stash:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(config.stash[_STATUS])
