"""Settings shared by all tests.

Property-based tests draw the same 40 examples in every run of `make test`, and 1,000 fresh ones in
`make fuzz`, which runs the tests marked ``fuzz``. Such a test sets no number of examples.
"""

import os
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import settings

# Matrices here are small: threads only wait for each other, and on a busy machine for minutes.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A shell starts what runs in its background with SIGINT ignored, and processes inherit that; tests
# that interrupt a command need it as it is in a foreground.
signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile(
    "repeatable", max_examples=40, derandomize=True, deadline=None, print_blob=True
)
settings.register_profile("fuzz", max_examples=1000, deadline=None, print_blob=True)
settings.load_profile("repeatable")  # --hypothesis-profile=fuzz takes its place


SLOW = (
    "benchmarks",
    "cli",
    "conformance",
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
    "scenario/test_shipped.py",
    "scenario/test_ssp.py",
    "sweep",
    "theory/test_weakened.py",
    "verify/test_measure.py",
)
"""Folders and files whose tests run processes, hosts, engines, all scenarios; `make test-fast`
leaves them out."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    tests = Path(__file__).parent
    slow = [tests / place for place in SLOW]

    def is_slow(item: pytest.Item) -> bool:
        return any(item.path.is_relative_to(place) for place in slow)

    for item in filter(is_slow, items):
        item.add_marker(pytest.mark.slow)
    # First, so that no long file is left for the end, when the other processes have nothing to do.
    items.sort(key=lambda item: not is_slow(item))


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
