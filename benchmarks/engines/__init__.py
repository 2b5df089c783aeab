"""Programs that run a loop, one file each; every one lives in a process of its own.

ENGINES      co-simulation engines with held inputs, made by others
ours         the master of congelation with its coupling `jacobi`
hermite      the same with `hermite`, steps chosen to a tolerance
bare, hollow the least a Python host can do; the same without the FMUs
monolithic   no FMUs: scipy on the equations inside them
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

__all__ = ["ENGINES", "Entry"]


@dataclass(frozen=True)
class Entry:
    """Where an engine is found.

    Parameters
    ----------
    label : str
        As in the tables.
    environment : str
        Folder of the virtual environment that it needs; empty for this one.
    quirk : str
        What differs from a plain Jacobi loop with outputs exchanged at the start; or empty.
    """

    label: str
    environment: str = ""
    quirk: str = ""


ENGINES: Mapping[str, Entry] = MappingProxyType(
    {
        "fmpy_loop": Entry("plain FMPy loop"),
        "fmpy_ssp": Entry("FMPy `simulate_ssp`", quirk="starts from zero inputs"),
        "libcosim": Entry("libcosim (libcosimpy)"),
        "ecos": Entry("Ecos (ecospy)"),
        "cofmupy": Entry("CoFmuPy", ".venv-cofmupy", quirk="starts from zero inputs"),
    }
)
"""Every engine of others, by the name of its module."""
