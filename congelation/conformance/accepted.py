"""Findings that are accepted: the limits of pythonfmu's library, and those of a file of the user's.

pythonfmu puts a prebuilt shared library around a Python class. What that library does with the
return values and exceptions of the class, and what it never hands to it, is out of the class's
reach; each limit names the rule that it breaks and the reason. A rule that is broken for an
FMU without that library is a violation like any other.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

from congelation.errors import InvalidInput, nearest

__all__ = ["LIMITS", "Accepted", "Limit", "is_pythonfmu", "limit_of", "read_known"]


@dataclass(frozen=True)
class Limit:
    """One thing that pythonfmu's shared library (0.7) does wrong.

    Attributes
    ----------
    rule : str
        Id of the rule that it breaks.
    sentence : str
        What happens, and why it cannot be mended from Python.
    says : str
        What the finding has to say to be this limit; "" for any text.
    """

    id: str
    rule: str
    sentence: str
    says: str = ""


def is_pythonfmu(directory: Path) -> bool:
    """Whether an unzipped FMU was built with pythonfmu."""
    return (directory / "resources" / "slavemodule.txt").is_file()


def limit_of(rule: str, what: str) -> Limit | None:
    """The limit that explains a finding, if there is one."""
    return next((limit for limit in LIMITS if limit.rule == rule and limit.says in what), None)


@dataclass(frozen=True)
class Accepted:
    """One entry of a file of known findings.

    Attributes
    ----------
    fmu : str
        Name of the FMU's file, with * and ? as in a shell.
    """

    rule: str
    fmu: str
    reason: str

    def covers(self, rule: str, path: Path) -> bool:
        """Whether the entry is about a rule in an FMU."""
        return self.rule == rule and fnmatch(path.name, self.fmu)


def read_known(path: Path, rules: Mapping[str, object]) -> tuple[Accepted, ...]:
    """Read a file of known findings: a TOML array ``known`` of tables with rule, fmu and reason.

    Raises
    ------
    InvalidInput
        The file cannot be read, or an entry is not complete or names no rule.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InvalidInput(f"{path}: {error}") from error
    entries = data.get("known", [])
    if set(data) - {"known"} or not isinstance(entries, list):
        raise InvalidInput(f"{path}: valid are entries [[known]] with rule, fmu and reason")
    found = []
    for number, entry in enumerate(entries, 1):
        where = f"{path}: entry {number} of [[known]]"
        if not isinstance(entry, dict) or set(entry) != {"rule", "fmu", "reason"}:
            raise InvalidInput(f"{where} needs rule, fmu and reason, and nothing else")
        if not all(isinstance(value, str) and value.strip() for value in entry.values()):
            raise InvalidInput(f"{where}: rule, fmu and reason are texts that are not empty")
        if entry["rule"] not in rules:
            name = entry["rule"]
            raise InvalidInput(f"{where}: no rule is named '{name}': {nearest(name, rules)}")
        found.append(Accepted(**entry))
    return tuple(found)


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
        "FMI2-EXP-04",
        "fmi2DoStep returns fmi2OK or fmi2Discard, or fmi2Fatal if Python raises; never fmi2Error.",
        says="returned fmi2Discard",
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
        "PYTHONFMU-10",
        "FMI2-FMUSTATE-04",
        "fmi2FreeFMUstate leaves the freed pointer in its argument, where null is due.",
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
