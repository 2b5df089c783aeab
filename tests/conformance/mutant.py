"""What a broken FMU is: the correct one, with one thing changed."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import lag

__all__ = [
    "XML",
    "Edit",
    "Mutant",
    "Pack",
    "archive",
    "exchanging",
    "extra",
    "renamed",
    "swap",
    "without",
    "xml",
]

XML = "modelDescription.xml"

Edit = Callable[[lag.Entries], lag.Entries]
Pack = Callable[[Path, lag.Entries], Path]


def archive(folder: Path, entries: lag.Entries) -> Path:
    """Pack as the standard wants it."""
    return lag.write_archive(folder / "lag.fmu", entries)


@dataclass(frozen=True)
class Mutant:
    """One broken FMU.

    Attributes
    ----------
    rule : str
        Id of the rule that has to catch it.
    says : str
        What the finding has to say, so that it is caught for the right reason.
    mutation : str
        Chosen in the library, "" for none.
    edit, pack : callable
        Applied to the contents; used to write the archive.
    companion : callable, optional
        Edit that makes the other FMU for rules that load two.
    time_limit : float
        Seconds to wait; short for what is known to hang.
    """

    rule: str
    says: str
    mutation: str = ""
    edit: Edit = field(default=lambda entries: entries)
    pack: Pack = archive
    companion: Edit | None = None
    time_limit: float = 60.0

    @property
    def label(self) -> str:
        """The name of the test case."""
        return f"{self.rule} {self.mutation or self.says}"


def swap(old: str, new: str) -> Edit:
    """Replace a piece of modelDescription.xml, which has to be there."""

    def edit(entries: lag.Entries) -> lag.Entries:
        text = entries[XML].decode()
        if old not in text:
            raise ValueError(f"{old!r} is not in {XML}")
        return {**entries, XML: text.replace(old, new, 1).encode()}

    return edit


# The FMU is for model exchange, too.
exchanging = swap(
    "  <CoSimulation\n",
    """  <ModelExchange
    modelIdentifier="lag"
    canNotUseMemoryManagementFunctions="true"
    canGetAndSetFMUstate="true"
    canSerializeFMUstate="true"
    providesDirectionalDerivative="true">
    <SourceFiles><File name="lag.c"/></SourceFiles>
  </ModelExchange>
  <CoSimulation
""",
)


def xml(rule: str, says: str, old: str, new: str) -> Mutant:
    """A mutant whose modelDescription.xml is another."""
    return Mutant(rule, says, edit=swap(old, new))


def extra(name: str, content: bytes = b"content") -> Edit:
    """One more entry in the archive."""
    return lambda entries: {**entries, name: content}


def without(name: str) -> Edit:
    """One entry less."""
    return lambda entries: {key: value for key, value in entries.items() if key != name}


def renamed(old: str, new: str) -> Edit:
    """An entry under another name."""
    return lambda entries: {re.sub(old, new, key): value for key, value in entries.items()}
