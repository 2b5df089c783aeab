"""Known limits: breaches that the authors of an FMU cannot mend, because its wrapper makes them.

pythonfmu puts a prebuilt shared library around a Python class. What that library does with the
return values and exceptions of the class, and what it never hands to it, is out of the class's
reach; each limit names the rule that it breaks and the reason. A rule that is broken for an
FMU without that library is a violation like any other.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

__all__ = ["LIMITS", "Limit", "is_pythonfmu", "limit_of"]


@dataclass(frozen=True)
class Limit:
    """One thing that pythonfmu's shared library (0.7) does wrong.

    Attributes
    ----------
    rule : str
        Id of the rule that it breaks.
    sentence : str
        What happens, and why it cannot be mended from Python.
    """

    id: str
    rule: str
    sentence: str


def is_pythonfmu(directory: Path) -> bool:
    """Whether an unzipped FMU was built with pythonfmu."""
    return (directory / "resources" / "slavemodule.txt").is_file()


def limit_of(rule: str) -> Limit | None:
    """The limit that breaks a rule, if there is one."""
    return next((limit for limit in LIMITS if limit.rule == rule), None)


LIMITS: tuple[Limit, ...] = (
    Limit(
        "PYTHONFMU-01",
        "FMI2-INST-01",
        "fmi2Instantiate never looks at the GUID, nor hands it to the Python class.",
    ),
    Limit(
        "PYTHONFMU-02",
        "FMI2-VALUE-05",
        "The get and set functions return fmi2OK, or fmi2Fatal if Python raises; no fmi2Error "
        "can be returned for an unknown value reference.",
    ),
    Limit(
        "PYTHONFMU-03",
        "FMI2-VALUE-07",
        "As for unknown value references: no fmi2Error can be returned for a wrong type.",
    ),
    Limit(
        "PYTHONFMU-04",
        "FMI2-VALUE-08",
        "As for unknown value references: no fmi2Error can be returned for setting a constant.",
    ),
    Limit(
        "PYTHONFMU-05",
        "FMI2-EXP-05",
        "fmi2DoStep returns fmi2OK or fmi2Discard, or fmi2Fatal if Python raises; never fmi2Error.",
    ),
    Limit(
        "PYTHONFMU-06",
        "FMI2-URI-02",
        "Only the prefix file:// is taken off the resource location; file:/path is used as it is.",
    ),
    Limit(
        "PYTHONFMU-07",
        "FMI2-URI-03",
        "Only the prefix file:// is taken off the resource location; an authority stays in front.",
    ),
    Limit(
        "PYTHONFMU-08",
        "FMI2-URI-05",
        "Of the percent-encoded characters of a resource location only %20 is decoded.",
    ),
    Limit(
        "PYTHONFMU-09",
        "FMI2-STATE-05",
        "fmi2GetStatus returns fmi2Error for every status, where fmi2Discard is due.",
    ),
    Limit(
        "PYTHONFMU-10",
        "FMI2-FMUSTATE-04",
        "fmi2FreeFMUstate leaves the freed pointer in its argument, where null is due.",
    ),
    Limit(
        "PYTHONFMU-11",
        "FMI2-SERIAL-05",
        "fmi2DeSerializeFMUstate returns fmi2OK, or fmi2Fatal if Python raises; never fmi2Error.",
    ),
    Limit(
        "PYTHONFMU-12",
        "FMI2-INST-09",
        "Every instantiation and every fmi2SetFMUstate leaks Python objects and adds an entry "
        "to sys.path.",
    ),
    Limit(
        "PYTHONFMU-13",
        "FMI2-LOG-06",
        "The logger is called only with loggingOn = fmi2True, for errors too.",
    ),
)
