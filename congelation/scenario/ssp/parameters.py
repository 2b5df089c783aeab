"""The values that parameter bindings of an SSD give."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from lxml import etree

from congelation.scenario.ssp.archive import Archive
from congelation.scenario.ssp.schema import NAMESPACES, PARAMETERS, parse

__all__ = ["bound_values"]

_PARAMETER_SET = "application/x-ssp-parameter-set"


def bound_values(element: etree._Element, archive: Archive, what: str) -> dict[str, object]:
    """The values that the parameter bindings of a component or system give, by name.

    Later bindings replace earlier ones. A value that states its unit is a table of both.

    Raises
    ------
    InvalidInput
        If a parameter set is missing or not valid, or if a binding cannot be followed; `what`
        names its owner.
    """
    values: dict[str, object] = {}
    for binding in element.findall("ssd:ParameterBindings/ssd:ParameterBinding", NAMESPACES):
        _check(binding, archive, what)
        prefix = binding.get("prefix", "")
        for parameter_set in _parameter_sets(binding, archive, what):
            for parameter in parameter_set.findall("ssv:Parameters/ssv:Parameter", NAMESPACES):
                values[prefix + parameter.get("name", "")] = _value(parameter, archive, what)
    return values


def _check(binding: etree._Element, archive: Archive, what: str) -> None:
    kind = binding.get("type", _PARAMETER_SET)
    if kind != _PARAMETER_SET:
        raise archive.error(f"{what}: parameters of type '{kind}'; give '{_PARAMETER_SET}'")
    if binding.find("ssd:ParameterMapping", NAMESPACES) is not None:
        raise archive.error(f"{what}: a parameter mapping; give the FMU's own names")
    if binding.get("sourceBase", "SSD") != "SSD":
        raise archive.error(f"{what}: parameters inside of an FMU; put them beside the SSD")


def _parameter_sets(
    binding: etree._Element, archive: Archive, what: str
) -> Iterator[etree._Element]:
    source = binding.get("source")
    if source is not None:
        content = archive.find(source, what).read_bytes()
        yield parse(content, PARAMETERS, f"{archive.file}: {source}")
    for inline in binding.findall("ssd:ParameterValues/ssv:ParameterSet", NAMESPACES):
        yield parse(etree.tostring(inline), PARAMETERS, f"{archive.file}: parameters of {what}")


def _value(parameter: etree._Element, archive: Archive, what: str) -> object:
    element = next(child for child in parameter if isinstance(child.tag, str))
    kind = etree.QName(element).localname
    if kind not in _READERS:
        name = parameter.get("name")
        known = ", ".join(_READERS)
        raise archive.error(f"{what}: parameter '{name}' is a value of type {kind}; give {known}")
    value = _READERS[kind](element.get("value", ""))
    if isinstance(value, str) and value and (archive.folder / value).is_file():
        value = str(archive.find(value, what))  # an FMU looks for files from where its host runs
    unit = element.get("unit")
    return value if unit is None else {"value": value, "unit": unit}


def _boolean(text: str) -> bool:
    return text.strip() in ("true", "1")


# float and int read every form of xs:double and xs:int; the schema has refused all others.
_READERS: Mapping[str, Callable[[str], float | int | bool | str]] = {
    "Real": float,
    "Integer": int,
    "Boolean": _boolean,
    "String": str,
}
