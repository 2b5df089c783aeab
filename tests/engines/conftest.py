"""The archives of the loops, exported once per session."""

from pathlib import Path

import pytest

from congelation.scenario.ssp import write_ssp
from tests.engines.loops import LOOPS, Loop, scenario


@pytest.fixture(scope="session")
def archives(tmp_path_factory: pytest.TempPathFactory) -> dict[Loop, Path]:
    """By loop: its SSP archive."""
    folder = tmp_path_factory.mktemp("ssp")
    files = {loop: folder / f"{loop}.ssp" for loop in LOOPS}
    for loop, file in files.items():
        write_ssp(scenario(loop), file, loop.variant)
    return files
