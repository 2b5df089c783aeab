"""The XML of SSP 1.0: its names, and its schemas, which FMPy brings along."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import fmpy
from lxml import etree

from congelation.errors import InvalidInput

__all__ = ["ANNOTATION", "DESCRIPTION", "NAMESPACES", "PARAMETERS", "SSD", "parse", "tag"]

SSD = "SystemStructure.ssd"
"""The file of an archive that describes its system."""

DESCRIPTION = "SystemStructureDescription"
"""Root of that file, and name of its schema."""

PARAMETERS = "SystemStructureParameterValues"
"""Name of the schema of parameter sets, whose root is ParameterSet."""

ANNOTATION = "congelation"
"""Type of the annotation for what SSP has no place for: coupling, step, metrics, figures."""

_SSP = "http://ssp-standard.org/SSP1/"
NAMESPACES = {
    "ssd": _SSP + DESCRIPTION,
    "ssv": _SSP + PARAMETERS,
    "ssc": _SSP + "SystemStructureCommon",
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
    "oms": "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
}
"""By prefix. libcosim, Ecos and OMSimulator look for these prefixes, not for the namespaces."""


def tag(element: str) -> str:
    """The qualified name of an element, ``ssd:System``, as lxml writes it."""
    prefix, _, name = element.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{name}"


def parse(data: bytes, schema: str, place: str) -> etree._Element:
    """The root of an XML document that is valid by a schema.

    Raises
    ------
    InvalidInput
        Beginning with `place`, if it is no XML, or not valid.
    """
    try:
        # No entities and no network: an archive may come from anyone.
        root = etree.fromstring(data, etree.XMLParser(resolve_entities=False, no_network=True))
    except etree.XMLSyntaxError as error:
        raise InvalidInput(f"{place}: no XML: {error.msg}") from error
    validator = _schema(schema)
    if not validator.validate(root):
        first = validator.error_log[0]
        raise InvalidInput(f"{place}, line {first.line}: {first.message}")
    return root


@cache
def _schema(name: str) -> etree.XMLSchema:
    return etree.XMLSchema(file=Path(fmpy.__file__).parent / "ssp" / "schema" / f"{name}.xsd")
