"""A rule: what it demands, on which sentence of the standard it rests, and the function that looks.

A rule is registered by its decorator, `static` or `dynamic`, and nowhere else. Its page
(``congelation check --explain RULE``) is the docstring of its function: the demand in one sentence,
then the paragraphs "Standard:" (a quotation, or "nothing" and what a host needs instead), "Why:",
"Remedy:" and "Example:".
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from congelation.conformance.bench import Bench
    from congelation.conformance.subject import Subject

__all__ = [
    "BY_ID",
    "DEFAULT_TIME_LIMIT",
    "NOT_RESTORED",
    "STATE_NOT_RESTORED",
    "Breach",
    "DynamicRule",
    "Level",
    "NotApplicable",
    "NotEvaluated",
    "Outcome",
    "Rule",
    "StaticRule",
    "Violated",
    "dynamic",
    "judge",
    "require",
    "static",
]

# A rule takes well under a second on a small FMU; the limit only has to tell slow from hung.
DEFAULT_TIME_LIMIT = 60.0


class Level(Enum):
    """How much a finding weighs; the value is the word shown to people."""

    VIOLATION = "violation"  # the standard demands it
    WARNING = "warning"  # the standard recommends it ("should")
    ROBUSTNESS = "robustness"  # the standard is silent; a host needs it

    @property
    def weight(self) -> int:
        """0 for the gravest."""
        return list(Level).index(self)


class Outcome(Enum):
    """What became of one rule for one FMU; the value is the word shown to people."""

    PASS = "pass"
    FOUND = "found"
    KNOWN = "known"
    NOT_APPLICABLE = "not applicable"
    NOT_EVALUATED = "not evaluated"


class NotApplicable(Exception):
    """The rule has nothing to look at in this FMU; the text says why."""


def require(there: object, otherwise: str) -> None:
    """Raise `NotApplicable` with this reason where something is missing, empty or false."""
    if not there:
        raise NotApplicable(otherwise)


class NotEvaluated(Exception):
    """Another finding keeps the rule from looking; the text says which."""


class Violated(Exception):
    """The rule is broken, and there is no point in looking further."""


@dataclass(frozen=True)
class Breach:
    """One place where a rule is broken.

    Attributes
    ----------
    file : str
        Path inside the FMU, "" for the FMU as a whole.
    line : int or None
        Line of that file.
    """

    what: str
    line: int | None = None
    file: str = ""


@dataclass(frozen=True)
class Rule:
    """One demand.

    Attributes
    ----------
    id : str
        Stable name, such as "FMI2-STATE-03".
    section : str
        Section of FMI 2.0.5.
    level : Level
        What a finding is.
    sentence : str
        The demand in one sentence.
    quote, why, remedy, example : str
        The paragraphs of the rule's page.
    """

    id: str
    section: str
    level: Level
    sentence: str
    quote: str
    why: str
    remedy: str
    example: str

    kind: ClassVar[str]

    def page(self) -> str:
        """What ``--explain`` prints."""
        parts = (
            f"{self.id} ({self.level.value}, {self.kind} rule, FMI 2.0.5 section {self.section})",
            self.sentence,
            f"Standard: {self.quote}",
            f"Why: {self.why}",
            f"Remedy: {self.remedy[0].upper()}{self.remedy[1:]}",
            f"Example: {self.example}",
        )
        return "\n\n".join(parts)


@dataclass(frozen=True)
class StaticRule(Rule):
    """A rule that looks at the archive and its XML; nothing of the FMU is executed."""

    look: Callable[[Subject], Iterable[str | Breach]]
    kind = "static"


@dataclass(frozen=True)
class DynamicRule(Rule):
    """A rule that calls the FMU's functions, in a process of its own.

    Attributes
    ----------
    time_factor : float
        Factor on the time limit, for rules that repeat something many times.
    ends_normally : bool
        Whether the way in which the process ends is part of what is judged.
    needs : str
        What has to work before the rule can look: "run" (a plain run), "library" (loading), "".
    owns : str
        Calls and abilities whose failure is this rule's finding, wherever it is met.
    """

    look: Callable[[Bench], Iterable[str | Breach]]
    time_factor: float = 1.0
    ends_normally: bool = False
    needs: str = "run"
    owns: frozenset[str] = field(default_factory=frozenset)
    kind = "dynamic"


# The cause of whatever differs after fmi2Reset. It does not contain the name of the call, because a
# call that fails is another fault.
NOT_RESTORED = "the reset does not restore all"
# The cause of whatever differs after fmi2SetFMUstate.
STATE_NOT_RESTORED = "the FMU state does not hold all"

BY_ID: dict[str, Rule] = {}


def _page(look: Callable[..., object]) -> dict[str, str]:
    """The paragraphs of a rule's docstring."""
    paragraphs = [" ".join(part.split()) for part in (look.__doc__ or "").split("\n\n")]
    found = {"sentence": paragraphs[0]}
    for paragraph in paragraphs[1:]:
        label, _, text = paragraph.partition(": ")
        found[{"Standard": "quote"}.get(label, label.lower())] = text
    return found


def static(
    name: str, section: str, level: Level
) -> Callable[[Callable[[Subject], Iterable[str | Breach]]], StaticRule]:
    """Register a function as a static rule; its docstring is the rule's page."""

    def register(look: Callable[[Subject], Iterable[str | Breach]]) -> StaticRule:
        rule = StaticRule(name, section, level, look=look, **_page(look))
        BY_ID[name] = rule
        return rule

    return register


def dynamic(
    name: str,
    section: str,
    level: Level,
    *,
    time_factor: float = 1.0,
    ends_normally: bool = False,
    needs: str = "run",
    owns: Iterable[str] = (),
) -> Callable[[Callable[[Bench], Iterable[str | Breach]]], DynamicRule]:
    """Register a function as a dynamic rule; its docstring is the rule's page."""

    def register(look: Callable[[Bench], Iterable[str | Breach]]) -> DynamicRule:
        rule = DynamicRule(
            name,
            section,
            level,
            look=look,
            time_factor=time_factor,
            ends_normally=ends_normally,
            needs=needs,
            owns=frozenset(owns),
            **_page(look),
        )
        BY_ID[name] = rule
        return rule

    return register


def _cause(what: str) -> str:
    """What failed, if the text of a breach tells that other rules may meet the same; else ""."""
    if re.match(r"fmi2\w+\b.* returned ", what):
        return what
    if re.match(r"(after setting it|from (a )?(state|handle)|after freeing another)\b.*: ", what):
        return STATE_NOT_RESTORED
    return NOT_RESTORED if re.match(r"after .*\bfmi2Reset\b.*: ", what) else ""


def judge(
    rule: StaticRule | DynamicRule, subject: Subject | Bench
) -> tuple[Outcome, tuple[Breach, ...], str, str]:
    """Let a rule look at its subject, in this process.

    Returns
    -------
    outcome : Outcome
        PASS, FOUND, NOT_APPLICABLE or NOT_EVALUATED.
    breaches : tuple of Breach
        Where the rule is broken.
    reason : str
        Why the rule does not apply or was not evaluated.
    cause : str
        The call that failed and its status, where that is the finding.
    """
    breaches: list[Breach] = []
    cause = ""
    try:
        for found in rule.look(subject):  # type: ignore[arg-type]  # each kind gets its own subject
            breaches.append(found if isinstance(found, Breach) else Breach(found))
    except (NotApplicable, NotEvaluated) as why:
        if not breaches:
            not_applicable = isinstance(why, NotApplicable)
            outcome = Outcome.NOT_APPLICABLE if not_applicable else Outcome.NOT_EVALUATED
            return outcome, (), str(why), ""
    except Violated as breach:
        breaches.append(Breach(str(breach)))
    except Exception as error:  # a defect of the rule, which must not look like one of the FMU
        reason = f"the check itself failed ({type(error).__name__}: {error}); please report it"
        return Outcome.NOT_EVALUATED, (), reason, ""
    causes = {_cause(breach.what) for breach in breaches}
    if len(causes) == 1:
        (cause,) = causes
    return (Outcome.FOUND if breaches else Outcome.PASS), tuple(breaches), "", cause
