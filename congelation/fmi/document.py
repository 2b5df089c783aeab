"""modelDescription.xml as a document: read, and refused where it is none that FMPy can be given."""

from __future__ import annotations

import zipfile
from functools import cache
from pathlib import Path
from threading import Lock

import fmpy
from lxml import etree

from congelation.errors import InvalidInput
from congelation.fmi.unpack import DAMAGED, check_archive, parse_xml, require_no_other_kind

__all__ = ["FMI2_SCHEMA", "check_references", "read_document", "schema_error", "schema_errors"]

FMI2_SCHEMA = Path(fmpy.__file__).parent / "schema" / "fmi2" / "fmi2ModelDescription.xsd"

_ONE_AT_A_TIME = Lock()

LARGEST_REFERENCE = 2**32 - 1
"""Value references are unsigned numbers of 32 bits."""


def read_document(path: Path) -> etree._Element:
    """The root of an FMU's modelDescription.xml.

    Raises
    ------
    InvalidInput
        The file is no FMU for co-simulation under FMI 2.0.
    """
    require_no_other_kind(path)
    check_archive(path, "an FMU")
    try:
        with zipfile.ZipFile(path) as archive:
            content = archive.read("modelDescription.xml")
    except (*DAMAGED, KeyError) as error:
        raise InvalidInput(f"{path} is not an FMU: {error}") from error
    try:
        root = parse_xml(content)
    except ValueError as error:
        raise InvalidInput(f"{path}: unreadable modelDescription.xml: {error}") from error
    _require_fmi_2(path, root)
    return root


def _require_fmi_2(path: Path, root: etree._Element) -> None:
    """Refuse what FMPy reads as well, or stumbles over: other versions and other documents."""
    if root.tag != "fmiModelDescription":
        raise InvalidInput(
            f"{path}: modelDescription.xml begins with '{root.tag}', not with 'fmiModelDescription'"
        )
    version = root.get("fmiVersion")
    if version is None:
        raise InvalidInput(f"{path}: modelDescription.xml states no fmiVersion; FMI 2.0 is needed")
    if version.startswith("2.0."):
        raise InvalidInput(f"{path}: fmiVersion = '{version}'; every FMU of FMI 2.0 states '2.0'")
    if version != "2.0":
        raise InvalidInput(f"{path}: an FMU of FMI {version}; one of FMI 2.0 is needed")
    simulation = root.find("CoSimulation")
    if simulation is None and root.find("ModelExchange") is None:
        raise InvalidInput(f"{path}: it offers neither co-simulation nor model exchange")
    if simulation is None:
        raise InvalidInput(f"{path}: an FMU for model exchange alone; co-simulation is needed")
    for element, attribute in ((root, "guid"), (simulation, "modelIdentifier")):
        if not element.get(attribute):
            raise InvalidInput(f"{path}: modelDescription.xml states no {attribute}")
    identifier = simulation.get("modelIdentifier", "")
    if {*identifier} & {"/", "\\", "\0"}:  # it names files
        raise InvalidInput(f"{path}: modelIdentifier '{identifier}' is not valid")


def check_references(root: etree._Element) -> None:
    """Refuse numbers that C and FMPy would take for others: too large, negative, or zero.

    Raises
    ------
    ValueError
    """
    variables = root.findall("ModelVariables/ScalarVariable")
    for variable in variables:
        reference = int(variable.get("valueReference", ""))
        if not 0 <= reference <= LARGEST_REFERENCE or not variable.get("name"):
            raise ValueError(f"line {variable.sourceline}: a variable without name or reference")
        if not variable.get("name", "").isprintable():
            raise ValueError(f"line {variable.sourceline}: a variable's name has a line break")
    for item in root.iterfind("TypeDefinitions/SimpleType/Enumeration/Item"):
        if not -(2**31) <= int(item.get("value", "")) < 2**31:
            raise ValueError(f"line {item.sourceline}: an item does not fit in 32 bits")
    for unknown in root.iterfind("ModelStructure/*/Unknown"):
        for text in (unknown.get("index", ""), *unknown.get("dependencies", "").split()):
            if not 1 <= int(text) <= len(variables):
                raise ValueError(
                    f"line {unknown.sourceline}: ModelStructure names the variable {text}; there "
                    f"are {len(variables)}, counted from 1"
                )


def schema_error(root: etree._Element) -> str:
    """The first thing in a model description that the schema of FMI 2.0 does not allow."""
    errors = schema_errors(FMI2_SCHEMA, root)
    return f"line {errors[0].line}: {errors[0].message}" if errors else ""


def schema_errors(schema: Path, root: etree._Element) -> list[etree._LogEntry]:
    """What a schema, a file, does not allow in a document, in the order of its lines.

    libxml2 reads one schema at a time, and keeps the errors of the last document alone; files are
    looked at in threads.
    """
    with _ONE_AT_A_TIME:
        known = _read_schema(schema)
        return [] if known.validate(root) else list(known.error_log)


@cache
def _read_schema(schema: Path) -> etree.XMLSchema:
    return etree.XMLSchema(file=schema)
