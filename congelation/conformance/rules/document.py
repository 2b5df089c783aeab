"""Rules about modelDescription.xml as a document, and about everything in it but variables."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.resources import as_file, files

from lxml import etree

from congelation.conformance.rule import NotApplicable, Rule, static
from congelation.conformance.subject import DESCRIPTION, Subject

__all__ = ["RULES"]

_DECLARATION = re.compile(rb"<\?xml[^>]*encoding=[\"'](?P<encoding>[^\"']+)[\"']")
_ZULU = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ")
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_SPECIAL = {"nan", "inf", "+inf", "-inf"}
# Attributes with numbers, in which the special values of xs:double are forbidden.
_NUMBERS = ("start", "min", "max", "nominal", "factor", "offset")
_EXPERIMENT = ("startTime", "stopTime", "tolerance", "stepSize")


@static("FMI2-XML-01", "2.2")
def encoding(subject: Subject) -> Iterator[str]:
    """modelDescription.xml is well-formed and declares the encoding UTF-8 in its first line."""
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
        yield f"not well-formed: {error}"


@cache
def _schema() -> etree.XMLSchema:
    with as_file(files("fmpy") / "schema" / "fmi2") as folder:
        return etree.XMLSchema(etree.parse(str(folder / "fmi2ModelDescription.xsd")))


@static("FMI2-XML-02", "2.2")
def schema(subject: Subject) -> Iterator[str]:
    """modelDescription.xml is valid by the schema fmi2ModelDescription.xsd."""
    document, checker = subject.root, _schema()
    if not checker.validate(document):
        for error in checker.error_log:
            yield f"line {error.line}: {error.message}"


@static("FMI2-XML-03", "2.2")
def no_special_values(subject: Subject) -> Iterator[str]:
    """No number in modelDescription.xml is NAN, INF, +INF or -INF."""
    for element in subject.root.iter(etree.Element):
        # The value of a String variable may be any text.
        names = _EXPERIMENT if element.tag == "DefaultExperiment" else _NUMBERS
        for name in () if element.tag == "String" else names:
            value = element.get(name)
            if value is not None and value.strip().lower() in _SPECIAL:
                yield f'line {element.sourceline}: {name}="{value}"'


@static("FMI2-XML-04", "2.2.1")
def generation_date(subject: Subject) -> Iterator[str]:
    """generationDateAndTime, if given, has the form YYYY-MM-DDThh:mm:ssZ."""
    date = subject.root.get("generationDateAndTime")
    if date is None:
        raise NotApplicable("no generationDateAndTime is given")
    if _ZULU.fullmatch(date) is None:
        yield f'generationDateAndTime="{date}"'


@static("FMI2-XML-05", "2.1.1")
def identifier(subject: Subject) -> Iterator[str]:
    """modelIdentifier is a C identifier (letters, digits, underscores)."""
    for kind in ("ModelExchange", "CoSimulation"):
        for element in subject.root.iterfind(kind):
            name = element.get("modelIdentifier", "")
            if _IDENTIFIER.fullmatch(name) is None:
                yield f'{kind} has modelIdentifier="{name}"'


@static("FMI2-XML-06", "2.2.1")
def some_interface(subject: Subject) -> Iterator[str]:
    """At least one of the elements ModelExchange and CoSimulation is present."""
    if not any(subject.root.find(kind) is not None for kind in ("ModelExchange", "CoSimulation")):
        yield "there is neither <ModelExchange> nor <CoSimulation>"


@static("FMI2-XML-07", "2.2.2-2.2.6")
def unique_names(subject: Subject) -> Iterator[str]:
    """Units, display units of a unit, types, log categories and annotations have unique names."""
    root = subject.root
    yield from _repeated("Unit", root.iterfind("UnitDefinitions/Unit"))
    for unit in root.iterfind("UnitDefinitions/Unit"):
        label = f"DisplayUnit of {unit.get('name')!r}"
        yield from _repeated(label, unit.iterfind("DisplayUnit"))
    yield from _repeated("SimpleType", root.iterfind("TypeDefinitions/SimpleType"))
    yield from _repeated("Category", root.iterfind("LogCategories/Category"))
    yield from _repeated("annotation of Tool", root.iterfind("VendorAnnotations/Tool"))


def _repeated(label: str, elements: Iterable[etree._Element]) -> Iterator[str]:
    for name, count in Counter(element.get("name") for element in elements).items():
        if count > 1:
            yield f"{label} {name!r} is defined {count} times"


@static("FMI2-XML-08", "2.2.3")
def enumerations(subject: Subject) -> Iterator[str]:
    """The values of an enumeration's items are unique, and so are their names."""
    types = list(subject.root.iterfind("TypeDefinitions/SimpleType[Enumeration]"))
    if not types:
        raise NotApplicable("no enumeration is defined")
    for kind in types:
        items = kind.findall("Enumeration/Item")
        for attribute in ("name", "value"):
            for value, count in Counter(item.get(attribute) for item in items).items():
                if count > 1:
                    yield f"{kind.get('name')} has {count} items with {attribute} {value!r}"


@static("FMI2-XML-09", "2.2.5")
def default_experiment(subject: Subject) -> Iterator[str]:
    """DefaultExperiment, if given, is one that can be run: stop after start, step and tolerance >
    0."""
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


@static("FMI2-XML-10", "4.3.1")
def serializing_needs_state(subject: Subject) -> Iterator[str]:
    """canSerializeFMUstate = true implies canGetAndSetFMUstate = true."""
    description = subject.description
    if not description.flag("canSerializeFMUstate"):
        raise NotApplicable("canSerializeFMUstate is false")
    if not description.flag("canGetAndSetFMUstate"):
        yield "canSerializeFMUstate is true and canGetAndSetFMUstate is false"


RULES: tuple[Rule, ...] = (
    encoding,
    schema,
    no_special_values,
    generation_date,
    identifier,
    some_interface,
    unique_names,
    enumerations,
    default_experiment,
    serializing_needs_state,
)
