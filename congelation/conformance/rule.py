"""A rule: what it demands, where the standard says so, and the function that looks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Any

__all__ = [
    "DEFAULT_TIME_LIMIT",
    "Finding",
    "Kind",
    "NotApplicable",
    "Outcome",
    "Rule",
    "Violated",
    "dynamic",
    "judge",
    "static",
]

# A rule takes well under a second on a small FMU; the limit only has to tell slow from hung.
DEFAULT_TIME_LIMIT = 60.0


class Kind(Enum):
    """How a rule looks: at the archive and its XML, or at the running binary."""

    STATIC = "static"
    DYNAMIC = "dynamic"


class Outcome(Enum):
    """What a rule found; the value is the word shown to people."""

    PASS = "pass"
    VIOLATION = "violation"
    NOT_APPLICABLE = "not applicable"
    KNOWN_LIMIT = "known limit"


class NotApplicable(Exception):
    """The rule has nothing to look at in this FMU; the text says why."""


class Violated(Exception):
    """The rule is broken, and there is no point in looking further."""


@dataclass(frozen=True)
class Rule:
    """One demand of the standard.

    Attributes
    ----------
    id : str
        Stable name, such as "FMI2-STATE-03".
    section : str
        Section of FMI 2.0.5 that makes the demand.
    sentence : str
        The demand in one sentence.
    kind : Kind
        Static rules get a `Subject`, dynamic ones a `Bench`, in a process of their own.
    look : callable
        Yields one line for each breach; may raise `NotApplicable` or `Violated`.
    patience : float
        Factor on the time limit, for rules that repeat something many times.
    ends_normally : bool
        Whether the way in which the process ends is part of what is judged.
    bare : bool
        Whether a dynamic rule is to look even if a plain run of the FMU fails.
    """

    id: str
    section: str
    sentence: str
    kind: Kind
    look: Callable[[Any], Iterable[str]]
    patience: float = 1.0
    ends_normally: bool = False
    bare: bool = False


@dataclass(frozen=True)
class Finding:
    """What one rule found in one FMU.

    Attributes
    ----------
    lines : tuple of str
        Breaches, or the reason why the rule does not apply.
    notes : tuple of str
        Things worth knowing that are no breach.
    limit : str
        Id of the known limit that explains the breach, "" for none.
    """

    rule: Rule
    outcome: Outcome
    lines: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    limit: str = ""


def static(name: str, section: str) -> Callable[[Callable[[Any], Iterable[str]]], Rule]:
    """Make a static rule of a function whose docstring is the rule's sentence."""
    return lambda look: Rule(name, section, _sentence(look), Kind.STATIC, look)


def dynamic(
    name: str,
    section: str,
    *,
    patience: float = 1.0,
    ends_normally: bool = False,
    bare: bool = False,
) -> Callable[[Callable[[Any], Iterable[str]]], Rule]:
    """Make a dynamic rule of a function whose docstring is the rule's sentence."""
    return lambda look: Rule(
        name, section, _sentence(look), Kind.DYNAMIC, look, patience, ends_normally, bare
    )


def _sentence(look: Callable[[Any], Iterable[str]]) -> str:
    return " ".join((look.__doc__ or "").split())


def judge(
    rule: Rule, subject: object, prepare: Callable[[], object] | None = None
) -> tuple[Outcome, tuple[str, ...]]:
    """Let a rule look at its subject, in this process.

    Parameters
    ----------
    prepare : callable, optional
        Called first; may raise `NotApplicable`.

    Returns
    -------
    outcome : Outcome
        PASS, VIOLATION or NOT_APPLICABLE.
    lines : tuple of str
        The breaches, or the reason why the rule does not apply.
    """
    lines: list[str] = []
    try:
        if prepare is not None:
            prepare()
        lines.extend(rule.look(subject))
    except NotApplicable as reason:
        if not lines:
            return Outcome.NOT_APPLICABLE, (str(reason),)
    except Violated as breach:
        lines.append(str(breach))
    return (Outcome.VIOLATION if lines else Outcome.PASS), tuple(lines)
