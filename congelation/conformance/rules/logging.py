"""Rules about the logger (sections 2.1.3, 2.1.5 and 2.2.4)."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from congelation.conformance.bench import Bench
from congelation.conformance.binding import LogMessage, Status
from congelation.conformance.instance import ENVIRONMENT, Instance
from congelation.conformance.rule import Level, dynamic, require
from congelation.conformance.rules.values import UNKNOWN
from congelation.conformance.trajectory import demand

__all__: list[str] = []

_ALL = "logAll"
_Provocation = Callable[[Bench, Instance], Status]


def _unknown(bench: Bench, instance: Instance) -> Status:
    instance.library.probe = UNKNOWN
    return instance.get("Real", [2**31 - 1])[0]


# Calls that a careful FMU refuses, and then has to explain itself.
_PROVOCATIONS: dict[str, _Provocation] = {
    "fmi2GetReal of an unknown reference": _unknown,
    "fmi2DoStep with a negative step": lambda b, i: i.step(b.grid.start, -b.grid.step),
    "fmi2DoStep with a step of zero": lambda b, i: i.step(b.grid.start, 0.0),
}


def _refusals(bench: Bench, *, logging: bool) -> Iterator[tuple[str, Status, list[LogMessage]]]:
    """Provoked statuses other than fmi2OK, each with the messages that came with it."""
    for what, provoke in _PROVOCATIONS.items():
        bench.library.probe = ""
        instance = bench.initialize(bench.fresh(logging=logging))
        before = len(instance.messages)
        status = provoke(bench, instance)
        if status != Status.OK:
            yield what, status, instance.messages[before:]
        instance.free()


def _all_messages(bench: Bench) -> list[LogMessage]:
    """Everything logged in a run and under provocation, logging on."""
    instance = bench.initialize(bench.fresh())
    bench.run(instance)
    demand(instance.terminate(), "fmi2Terminate")
    messages = list(instance.messages)
    instance.free()
    for _, _, more in _refusals(bench, logging=True):
        messages.extend(more)
    require(messages, "the FMU logs nothing, whatever is done")
    return messages


@dynamic("FMI2-LOG-01", "2.1.5, 2.2.4", Level.VIOLATION)
def categories(bench: Bench) -> Iterator[str]:
    """The category of a message is one of LogCategories, or null if there are none.

    Standard: "The allowed values for category are defined in the modelDescription.xml file"; "If
    the FMU does not define any log categories, category must be a null pointer."

    Why: Hosts filter by category.

    Remedy: List the category under LogCategories, or pass null where there are none

    Example: "logAll" without LogCategories.
    """
    allowed: tuple[str | None, ...] = bench.description.categories or (None,)
    for found in sorted(
        {str(m.category) for m in _all_messages(bench) if m.category not in allowed}
    ):
        yield f"the category {found!r} is not among LogCategories"


@dynamic("FMI2-LOG-02", "2.1.3, 2.1.5", Level.WARNING)
def quiet(bench: Bench) -> Iterator[str]:
    """With loggingOn = fmi2False a run without errors logs nothing.

    Standard: "logger should only be called for log categories that were enabled"

    Why: Logs of many runs are large.

    Remedy: Test loggingOn before the logger is called

    Example: A message at every step.
    """
    instance = bench.initialize(bench.fresh(logging=False))
    bench.run(instance)
    demand(instance.terminate(), "fmi2Terminate")
    messages = [m for m in instance.messages if m.status == Status.OK]
    instance.free()
    if messages:
        yield f"{len(messages)} messages, the first: {messages[0].shown!r}"


@dynamic("FMI2-LOG-03", "2.1.3", Level.VIOLATION)
def explained(bench: Bench) -> Iterator[str]:
    """Every status other than fmi2OK comes with a log message, if logging is on.

    Standard: of fmi2Warning, fmi2Discard, fmi2Error and fmi2Fatal: "Function logger was called"

    Why: Without the reason nobody can correct it.

    Remedy: Call the logger before such a status is returned

    Example: return fmi2Error; without a message.
    """
    nothing = True
    for what, status, messages in _refusals(bench, logging=True):
        nothing = False
        if not any((m.text or "").strip() for m in messages):
            yield f"{what} returned {status} and logged nothing"
    require(not nothing, "no provocation was refused")


@dynamic("FMI2-LOG-04", "2.1.5", Level.WARNING)
def selection(bench: Bench) -> Iterator[str]:
    """After fmi2SetDebugLogging only messages of the chosen categories are logged, or none.

    Standard: "logger should only be called for log categories that were enabled by a call to
    fmi2SetDebugLogging"

    Why: The user chose what to see.

    Remedy: Test the category before the logger is called

    Example: All categories, whichever are chosen.
    """
    names = bench.description.categories
    require(names, "there are no LogCategories")
    for chosen in names:
        instance = bench.initialize(bench.fresh(logging=False))
        demand(instance.set_logging(True, [chosen]), f"fmi2SetDebugLogging for {chosen!r}")
        before = len(instance.messages)
        bench.run(instance)
        logged = {m.category for m in instance.messages[before:] if m.status == Status.OK}
        # logAll stands for all categories.
        others = set() if chosen == _ALL else logged - {chosen}
        for other in sorted(map(str, others)):
            yield f"with {chosen!r} alone switched on, {other!r} was logged"
        demand(instance.set_logging(False), "fmi2SetDebugLogging off")
        before = len(instance.messages)
        bench.run(instance, first=bench.grid.steps, last=2 * bench.grid.steps)
        if any(m.status == Status.OK for m in instance.messages[before:]):
            yield "messages are logged after logging was switched off"
        instance.free()


@dynamic("FMI2-LOG-05", "2.1.5", Level.VIOLATION)
def arguments(bench: Bench) -> Iterator[str]:
    """The logger gets the instance's name and environment.

    Standard: "instanceName is the name of the FMU instance that calls this function";
    componentEnvironment "needs to be passed to the logger function"

    Why: Hosts find the instance by them.

    Remedy: Pass both as they were given to fmi2Instantiate

    Example: The model's name in place of the instance's.
    """
    for m in _all_messages(bench):
        if m.instance != "tested":
            yield f"the instance name is {m.instance!r} instead of 'tested'"
        elif m.environment != ENVIRONMENT:
            yield "componentEnvironment is not the pointer given to fmi2Instantiate"
        else:
            continue
        return


@dynamic("FMI2-LOG-07", "2.1.5", Level.WARNING)
def message_text(bench: Bench) -> Iterator[str]:
    """A message has a text, which does not end in a line break.

    Standard: message "may contain line-breaks, but should not have a trailing line break"

    Why: Hosts add one.

    Remedy: Remove the last line break, and log no empty text

    Example: A text that ends in a line feed.
    """
    for m in _all_messages(bench):
        if not m.text:
            yield "a message has no text"
        elif m.text.endswith("\n"):
            yield f"the text ends in a line break: {m.shown!r}"
        else:
            continue
        return


@dynamic("FMI2-LOG-06", "2.1.3", Level.ROBUSTNESS)
def errors_always_logged(bench: Bench) -> Iterator[str]:
    """fmi2Warning and fmi2Error come with a log message even with loggingOn = fmi2False.

    Standard: sections 2.1.3 and 2.1.5 contradict each other on errors with loggingOn = fmi2False.

    Why: A study runs with logging off and needs the reason of a failure.

    Remedy: Log errors always

    Example: Errors that are logged in debug mode only.
    """
    nothing = True
    for what, status, messages in _refusals(bench, logging=False):
        # A discarded step is to be explained in debug mode only.
        if status in (Status.WARNING, Status.ERROR, Status.FATAL):
            nothing = False
            if not messages:
                yield f"{what} returned {status} and logged nothing"
    require(not nothing, "no provocation was answered with fmi2Warning or fmi2Error")
