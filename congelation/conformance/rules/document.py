"""Rules about modelDescription.xml as a document, and about everything in it but variables."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator

from lxml import etree

from congelation.conformance.rule import Breach, Level, NotApplicable, require, static
from congelation.conformance.subject import DESCRIPTION, Subject
from congelation.fmi.document import FMI2_SCHEMA, schema_errors

__all__: list[str] = []

_DECLARATION = re.compile(rb"<\?xml[^>]*encoding=[\"'](?P<encoding>[^\"']+)[\"']")
_ZULU = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ")
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_SPECIAL = {"nan", "inf", "+inf", "-inf"}
# Attributes with numbers, in which the special values of xs:double are forbidden.
_NUMBERS = ("start", "min", "max", "nominal", "factor", "offset")
_EXPERIMENT = ("startTime", "stopTime", "tolerance", "stepSize")


@static("FMI2-XML-01", "2.2", Level.VIOLATION)
def encoding(subject: Subject) -> Iterator[str | Breach]:
    """modelDescription.xml is well-formed and declares the encoding UTF-8 in its first line.

    Standard: "It is required that the encoding scheme is always UTF-8"

    Why: Strings go from the XML to the C functions unchanged.

    Remedy: Start the file with <?xml version="1.0" encoding="UTF-8"?>; if it is not well-formed,
    mend the line that is named, or write the file anew: an incomplete one has no end tag

    Example: encoding="ISO-8859-1".
    """
    if subject.xml is None:
        raise NotApplicable(f"there is no {DESCRIPTION}; see FMI2-PACK-02")
    found = _DECLARATION.match(subject.xml.removeprefix(b"\xef\xbb\xbf").split(b"\n")[0])
    if found is None:
        yield "the first line declares no encoding"
    elif found["encoding"].upper() != b"UTF-8":
        yield f"the declared encoding is {found['encoding'].decode(errors='replace')}, not UTF-8"
    try:
        etree.fromstring(subject.xml)
    except etree.XMLSyntaxError as error:
        yield Breach(f"not well-formed: {error.msg}", error.lineno, DESCRIPTION)


@static("FMI2-XML-02", "2.2", Level.VIOLATION)
def schema(subject: Subject) -> Iterator[str | Breach]:
    """modelDescription.xml is valid by the schema fmi2ModelDescription.xsd.

    Standard: the schema fmi2ModelDescription.xsd that belongs to the standard

    Why: Importers read by the schema.

    Remedy: Write the element or attribute as the schema has it

    Example: An attribute that the schema does not know.
    """
    for error in schema_errors(FMI2_SCHEMA, subject.root):
        yield Breach(error.message, error.line, DESCRIPTION)


@static("FMI2-XML-03", "2.2", Level.VIOLATION)
def no_special_values(subject: Subject) -> Iterator[str | Breach]:
    """No number in modelDescription.xml is NAN, INF, +INF or -INF.

    Standard: "The special values NAN, INF, +INF, and -INF for variables values are not allowed in
    the FMI XML files."

    Why: Parsers differ in reading them.

    Remedy: Leave the attribute out, or write a number

    Example: max="INF".
    """
    for element in subject.root.iter(etree.Element):
        # The value of a String variable may be any text.
        names = _EXPERIMENT if element.tag == "DefaultExperiment" else _NUMBERS
        for name in () if element.tag == "String" else names:
            value = element.get(name)
            if value is not None and value.strip().lower() in _SPECIAL:
                yield Breach(f'{name}="{value}"', element.sourceline, DESCRIPTION)


@static("FMI2-XML-04", "2.2.1", Level.WARNING)
def generation_date(subject: Subject) -> Iterator[str | Breach]:
    """generationDateAndTime, if given, has the form YYYY-MM-DDThh:mm:ssZ.

    Standard: the format "should be: YYYY-MM-DDThh:mm:ssZ"

    Why: Tools sort by the text.

    Remedy: Write the time in UTC with Z

    Example: 2024-01-01T00:00:00+01:00.
    """
    date = subject.root.get("generationDateAndTime")
    if date is None:
        raise NotApplicable("no generationDateAndTime is given")
    if _ZULU.fullmatch(date) is None:
        yield Breach(f'generationDateAndTime="{date}"', subject.root.sourceline, DESCRIPTION)


@static("FMI2-XML-05", "2.1.1", Level.VIOLATION)
def identifier(subject: Subject) -> Iterator[str | Breach]:
    """modelIdentifier is a C identifier (letters, digits, underscores).

    Standard: "Short class name according to C syntax"

    Why: It is a prefix of C functions and the name of the library.

    Remedy: Use letters, digits and underscores alone

    Example: modelIdentifier="my.model".
    """
    for kind in ("ModelExchange", "CoSimulation"):
        for element in subject.root.iterfind(kind):
            name = element.get("modelIdentifier", "")
            if _IDENTIFIER.fullmatch(name) is None:
                yield Breach(
                    f'{kind} has modelIdentifier="{name}"', element.sourceline, DESCRIPTION
                )


@static("FMI2-XML-06", "2.2.1", Level.VIOLATION)
def some_interface(subject: Subject) -> Iterator[str]:
    """At least one of the elements ModelExchange and CoSimulation is present.

    Standard: "At least one element of ModelExchange or CoSimulation must be present to identify
    the type of the FMU."

    Why: Without it nobody knows how to run the FMU.

    Remedy: Add <CoSimulation> or <ModelExchange>

    Example: Neither of the two.
    """
    if not any(subject.root.find(kind) is not None for kind in ("ModelExchange", "CoSimulation")):
        yield "there is neither <ModelExchange> nor <CoSimulation>"


@static("FMI2-XML-07", "2.2.2-2.2.6", Level.VIOLATION)
def unique_names(subject: Subject) -> Iterator[str | Breach]:
    """Units, display units of a unit, types, log categories and annotations have unique names.

    Standard: each name "must be unique with respect to all other elements" of its list

    Why: A reference by name has to have one target.

    Remedy: Rename or remove the second one

    Example: Two <Unit name="s">.
    """
    root = subject.root
    yield from _repeated("Unit", root.iterfind("UnitDefinitions/Unit"))
    for unit in root.iterfind("UnitDefinitions/Unit"):
        label = f"DisplayUnit of {unit.get('name')!r}"
        yield from _repeated(label, unit.iterfind("DisplayUnit"))
    yield from _repeated("SimpleType", root.iterfind("TypeDefinitions/SimpleType"))
    yield from _repeated("Category", root.iterfind("LogCategories/Category"))
    yield from _repeated("annotation of Tool", root.iterfind("VendorAnnotations/Tool"))


def _repeated(label: str, elements: Iterable[etree._Element]) -> Iterator[Breach]:
    places: dict[str, list[int]] = defaultdict(list)
    for element in elements:
        places[element.get("name")].append(element.sourceline)
    for name, lines in places.items():
        if len(lines) > 1:
            what = f"{label} {name!r} is defined {len(lines)} times"
            yield Breach(what, lines[1], DESCRIPTION)


@static("FMI2-XML-08", "2.2.3", Level.VIOLATION)
def enumerations(subject: Subject) -> Iterator[str | Breach]:
    """The values of an enumeration's items are unique, and so are their names.

    Standard: "The values can be any integer number but must be unique within the same
    enumeration"

    Why: The mapping of names to values has to be one to one.

    Remedy: Give each item its own value

    Example: Two items with value="1".
    """
    types = list(subject.root.iterfind("TypeDefinitions/SimpleType[Enumeration]"))
    require(types, "no enumeration is defined")
    for kind in types:
        items = kind.findall("Enumeration/Item")
        for attribute in ("name", "value"):
            for value, count in Counter(item.get(attribute) for item in items).items():
                if count > 1:
                    what = f"{kind.get('name')} has {count} items with {attribute} {value!r}"
                    yield Breach(what, kind.sourceline, DESCRIPTION)


@static("FMI2-XML-09", "2.2.5", Level.ROBUSTNESS)
def default_experiment(subject: Subject) -> Iterator[str]:
    """DefaultExperiment, if given, is one that can be run: stop after start, step and tolerance
    above 0.

    Standard: nothing; a host that runs the default experiment needs one that can be run.

    Why: A test run takes its times from here.

    Remedy: Give a stopTime after startTime, a stepSize and a tolerance above 0

    Example: stopTime="-1".
    """
    experiment = subject.description.experiment
    if subject.root.find("DefaultExperiment") is None:
        raise NotApplicable("there is no DefaultExperiment")
    start = experiment.start or 0.0
    if experiment.stop is not None and not experiment.stop > start:
        yield f"stopTime {experiment.stop:g} is not after startTime {start:g}"
    if experiment.step is not None and not experiment.step > 0.0:
        yield f"stepSize {experiment.step:g} is not positive"
    if experiment.tolerance is not None and not experiment.tolerance > 0.0:
        yield f"tolerance {experiment.tolerance:g} is not positive"


@static("FMI2-XML-10", "4.3.1", Level.VIOLATION)
def serializing_needs_state(subject: Subject) -> Iterator[str]:
    """canSerializeFMUstate = true implies canGetAndSetFMUstate = true.

    Standard: "If this is the case, then flag canGetAndSetFMUstate must be true as well."

    Why: Only a state that was got can be serialized.

    Remedy: Set canGetAndSetFMUstate="true" too

    Example: canSerializeFMUstate="true" alone.
    """
    description = subject.description
    require(description.flag("canSerializeFMUstate"), "canSerializeFMUstate is false")
    if not description.flag("canGetAndSetFMUstate"):
        yield "canSerializeFMUstate is true and canGetAndSetFMUstate is false"
