"""Rules about ModelVariables: names, combinations of attributes, starts, units, types, aliases."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterator

from congelation.conformance.description import Variable
from congelation.conformance.rule import Breach, Level, NotApplicable, require, static
from congelation.conformance.subject import DESCRIPTION, Subject

__all__ = ["at"]

# The causalities with which each variability may be combined (section 2.2.7).
_CAUSALITIES = {
    "constant": {"output", "local"},
    "fixed": {"parameter", "calculatedParameter", "local"},
    "tunable": {"parameter", "calculatedParameter", "local"},
    "discrete": {"input", "output", "local"},
    "continuous": {"input", "output", "local", "independent"},
}

# Variables of one alias set that a finding names.
_NAMED = 5

_PLAIN = r"[A-Za-z_][A-Za-z0-9_]*"
_QUOTED = r"'(?:[A-Za-z0-9_!#$%&()*+,\-./:;<>=?@\[\]^{}|~ ]|\\['\"?\\abfnrtv])+'"
_PART = rf"(?:{_PLAIN}|{_QUOTED})(?:\[\d+(?:,\d+)*\])?"
_PATH = rf"{_PART}(?:\.{_PART})*"
_STRUCTURED = re.compile(rf"{_PATH}|der\({_PATH}(?:,\d+)?\)")
_ELEMENT = re.compile(r"(?P<before>.*)\[(?P<indices>\d+(?:,\d+)*)\](?P<after>[^\[\]]*)")


def at(v: Variable, what: str) -> Breach:
    """A breach where a variable is declared."""
    return Breach(what, v.line, DESCRIPTION)


@static("FMI2-VARS-01", "2.2.7, 2.2.9", Level.VIOLATION)
def names(subject: Subject) -> Iterator[Breach]:
    """Variable names are unique, not empty, and keep to variableNamingConvention.

    Standard: "The full, unique name of the variable"; under the structured convention a name
    follows the grammar of 2.2.9

    Why: Variables are connected by name.

    Remedy: Rename the variable; a name that is unique and no structured one may stay if the
    convention is declared to be "flat"

    Example: Two variables named y.
    """
    description = subject.description
    structured = description.naming == "structured"
    counts = Counter(v.name for v in description.variables)
    for name, v in {v.name: v for v in description.variables}.items():
        count = counts[name]
        if count > 1:
            yield at(v, f"{count} variables are named {name!r}")
        if not name:
            yield at(v, "a variable has an empty name")
        elif structured and _STRUCTURED.fullmatch(name) is None:
            yield at(v, f"{name!r} is no structured name")
        elif not structured and re.search(r"[\r\n\t]", name):
            yield at(v, f"{name!r} contains a carriage return, a line feed or a tab")


@static("FMI2-VARS-02", "2.2.9", Level.VIOLATION)
def array_order(subject: Subject) -> Iterator[Breach]:
    """Under the structured convention the elements of an array are consecutive, in row-major order.

    Standard: "All array elements are given in a consecutive sequence of ScalarVariables", in "row
    major" order

    Why: Importers build arrays from the sequence.

    Remedy: List the elements in order, or declare the convention "flat"

    Example: a[1], b, a[2].
    """
    description = subject.description
    if description.naming != "structured":
        raise NotApplicable("variableNamingConvention is not structured")
    places: dict[tuple[str, str], list[tuple[int, tuple[int, ...]]]] = defaultdict(list)
    for variable in description.variables:
        found = _ELEMENT.fullmatch(variable.name)
        # An array of records ("a[1].b", "a[2].b") interleaves by right; only leaves are judged.
        if found is not None and "." not in found["after"]:
            indices = tuple(int(number) for number in found["indices"].split(","))
            places[found["before"], found["after"]].append((variable.index, indices))
    for (before, after), elements in places.items():
        positions = [position for position, _ in elements]
        v = description.variables[positions[0] - 1]
        if positions != list(range(positions[0], positions[0] + len(positions))):
            yield at(v, f"the elements of {before}[]{after} are not consecutive")
        elif [indices for _, indices in elements] != sorted(indices for _, indices in elements):
            yield at(v, f"the elements of {before}[]{after} are not in row-major order")


@static("FMI2-VARS-03", "2.2.7", Level.VIOLATION)
def combinations(subject: Subject) -> Iterator[Breach]:
    """The combination of causality, variability and type is one that the table allows.

    Standard: "The following combinations of variability/causality settings are allowed"; "Only a
    variable of type = Real can be continuous"

    Why: Causality and variability say when a value may be set and may change.

    Remedy: Write a variability that the table allows (fixed or tunable for parameters, discrete
    for other types than Real)

    Example: causality="parameter" without variability.
    """
    for v in subject.description.variables:
        if v.causality not in _CAUSALITIES.get(v.variability, set()):
            yield at(v, f'{v.name}: causality="{v.causality}" with variability="{v.variability}"')
        if v.variability == "continuous" and v.element != "Real":
            given = "" if "variability" in v.attributes else " (the default)"
            yield at(v, f'{v.name}: a variable of type {v.element} is "continuous"{given}')


def _allowed_initial(v: Variable) -> set[str]:
    if v.causality in ("input", "independent"):
        return set()
    if v.causality == "parameter" or v.variability == "constant":
        return {"exact"}
    if v.causality == "calculatedParameter" or v.variability in ("fixed", "tunable"):
        return {"approx", "calculated"}
    return {"exact", "approx", "calculated"}


@static("FMI2-VARS-04", "2.2.7", Level.VIOLATION)
def initial(subject: Subject) -> Iterator[Breach]:
    """initial, if given, is one that the table allows for the causality and variability.

    Standard: the table of "possible values" of initial

    Why: Initial says what is solved for at initialization.

    Remedy: Leave initial out, or write a value of the table

    Example: Initial="calculated" for a parameter.
    """
    for v in subject.description.variables:
        if v.given_initial is not None and v.given_initial not in _allowed_initial(v):
            yield at(
                v,
                f'{v.name}: initial="{v.given_initial}" with causality="{v.causality}", '
                f'variability="{v.variability}"',
            )


@static("FMI2-VARS-05", "2.2.7", Level.VIOLATION)
def starts(subject: Subject) -> Iterator[Breach]:
    """There is a start value where initial is exact or approx or the variable an input, nowhere
    else.

    Standard: "If initial = exact or approx, or causality = input, a start value must be provided.
    If initial = calculated, or causality = independent, it is not allowed to provide a start
    value."

    Why: Hosts set and show start values.

    Remedy: Add the start value, or remove it

    Example: An input without start.
    """
    for v in subject.description.variables:
        needed = v.causality == "input" or v.initial in ("exact", "approx")
        if needed and v.start_text is None:
            yield at(v, f"{v.name} has no start value")
        if not needed and v.start_text is not None:
            reason = "independent" if v.causality == "independent" else 'initial="calculated"'
            yield at(v, f"{v.name} ({reason}) has a start value")


@static("FMI2-VARS-06", "2.2.7", Level.VIOLATION)
def independent(subject: Subject) -> Iterator[Breach]:
    """At most one variable is independent, and it is a Real.

    Standard: "At most one ScalarVariable of an FMU can be defined as independent"; "it must be
    defined as Real"

    Why: There is one time.

    Remedy: Leave one independent Real

    Example: Time and t, both independent.
    """
    found = [v for v in subject.description.variables if v.causality == "independent"]
    require(found, "no variable is declared independent")
    if len(found) > 1:
        yield at(found[-1], "independent are " + ", ".join(v.name for v in found))
    for v in found:
        if v.element != "Real":
            yield at(v, f"{v.name} is independent and a {v.element}")


@static("FMI2-VARS-07", "2.2.2, 2.2.3", Level.VIOLATION)
def units(subject: Subject) -> Iterator[Breach]:
    """Every unit is defined under UnitDefinitions; a displayUnit comes with a unit.

    Standard: "Unit of the variable defined with UnitDefinitions.Unit.name"; "It is an error if
    displayUnit is defined in element Real, but unit is not"

    Why: Hosts check and convert units.

    Remedy: Define the unit under UnitDefinitions, or remove the attribute

    Example: unit="m/s" without a <Unit name="m/s">.
    """
    root = subject.root
    defined = {unit.get("name") for unit in root.iterfind("UnitDefinitions/Unit")}
    inherited = {
        kind.get("name"): kind.find("Real").get("unit")
        for kind in root.iterfind("TypeDefinitions/SimpleType[Real]")
    }
    reals = [
        *root.iterfind("TypeDefinitions/SimpleType/Real"),
        *root.iterfind("ModelVariables/ScalarVariable/Real"),
    ]
    for real in reals:
        owner = real.getparent().get("name")
        unit = real.get("unit", inherited.get(real.get("declaredType")))
        if unit is not None and unit not in defined:
            yield Breach(
                f"the unit {unit!r} of {owner} is not defined", real.sourceline, DESCRIPTION
            )
        if unit is None and real.get("displayUnit") is not None:
            yield Breach(f"{owner} has a displayUnit and no unit", real.sourceline, DESCRIPTION)


@static("FMI2-VARS-08", "2.2.3, 2.2.7", Level.VIOLATION)
def types(subject: Subject) -> Iterator[Breach]:
    """A declaredType is defined, is of the variable's type, and is no variable's name.

    Standard: declaredType is the "name of type defined with TypeDefinitions / SimpleType"; its
    name "must be different to all name attributes of ScalarVariables"

    Why: The defaults of a variable come from its type.

    Remedy: Define the type, or remove the attribute

    Example: declaredType="Length" without that SimpleType.
    """
    root = subject.root
    kinds = {
        kind.get("name"): {child.tag for child in kind}
        for kind in root.iterfind("TypeDefinitions/SimpleType")
    }
    for v in subject.description.variables:
        declared = v.attributes.get("declaredType")
        if v.name in kinds:
            yield at(v, f"{v.name} is the name of a variable and of a type")
        if declared is not None and declared not in kinds:
            yield at(v, f"the type {declared!r} of {v.name} is not defined")
        elif declared is not None and v.element not in kinds[declared]:
            yield at(v, f"{v.name} is {v.element}, its type {declared!r} is not")


@static("FMI2-VARS-09", "2.2.7", Level.VIOLATION)
def aliases(subject: Subject) -> Iterator[Breach]:
    """Aliases: at most one settable, at most one start, constants among themselves, one unit.

    Standard: the four restrictions on alias variables: "Variables a and b that can both be set
    [..] cannot be alias variables", "At most one variable of the same alias set [..] can have a
    start attribute"

    Why: Setting one alias changes the other.

    Remedy: Give the variables value references of their own, or remove the second start or unit

    Example: Two parameters with one valueReference.
    """
    groups: dict[tuple[str, int], list[Variable]] = defaultdict(list)
    for v in subject.description.variables:
        groups[v.base, v.reference].append(v)
    for (base, reference), group in groups.items():
        if len(group) > 1:
            for breach in _alias_breaches(group):
                names = ", ".join(v.name for v in group[:_NAMED])
                names += f" and {len(group) - _NAMED} more" if len(group) > _NAMED else ""
                yield at(group[-1], f"{base} {reference} ({names}): {breach}")


def _alias_breaches(group: list[Variable]) -> Iterator[str]:
    settable = [
        v for v in group if v.settable_before_start or v.causality in ("input", "independent")
    ]
    constants = [v for v in group if v.variability == "constant"]
    if len(settable) > 1:
        yield "more than one can be set"
    if constants and len(constants) < len(group):
        yield "constants share a reference with variables that are none"
    if len(constants) == len(group) and len({v.start for v in group}) > 1:
        yield "constants with different values"
    if len([v for v in group if v.start_text is not None and v not in constants]) > 1:
        yield "more than one has a start value"
    # A unit may also come from a declared type; then the attribute says nothing.
    if len({v.attributes.get("unit") for v in group if "declaredType" not in v.attributes}) > 1:
        yield "different units"


@static("FMI2-VARS-10", "2.2.7", Level.VIOLATION)
def model_exchange_attributes(subject: Subject) -> Iterator[Breach]:
    """A co-simulation FMU has neither canHandleMultipleSetPerTimeInstant nor reinit.

    Standard: "if only CoSimulation FMU, this attribute must not be present"

    Why: The attributes are for model exchange.

    Remedy: Remove the attribute

    Example: reinit="false" in a co-simulation FMU.
    """
    if subject.root.find("ModelExchange") is not None:
        raise NotApplicable("the FMU is for model exchange too")
    for v in subject.description.variables:
        for name in ("canHandleMultipleSetPerTimeInstant", "reinit"):
            if name in v.attributes:
                yield at(v, f"{v.name} has the attribute {name}")


@static("FMI2-VARS-11", "2.2.7", Level.VIOLATION)
def derivatives(subject: Subject) -> Iterator[Breach]:
    """The attribute derivative of a Real variable is the index of another Real variable.

    Standard: "If present, this variable is the derivative of variable with ScalarVariable index
    derivative."

    Why: States are found by this index.

    Remedy: Write the index (from 1) of the Real variable that is derived

    Example: derivative="99" of 20 variables.
    """
    description = subject.description
    found = [v for v in description.variables if "derivative" in v.attributes]
    require(found, "no variable has the attribute derivative")
    for v in found:
        target = description.variable(int(v.attributes["derivative"]))
        if target is None or target.element != "Real" or target is v:
            yield at(v, f"{v.name} is the derivative of {v.attributes['derivative']}")
