"""SSP archives: units, connectors and parameters that mean something, or are refused."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from congelation.errors import InvalidInput
from congelation.scenario.scenario import Scenario
from congelation.scenario.ssp import read_ssp

UNITS = {
    "K": '<BaseUnit K="1"/>',
    "degC": '<BaseUnit K="1" offset="273.15"/>',
    "<": "",  # no XML
}
HEAD = (
    '<ssd:SystemStructureDescription version="{version}" name="pair" '
    'xmlns:ssd="http://ssp-standard.org/SSP{major}/SystemStructureDescription" '
    'xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" '
    'xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues">'
)


def description(unit: str) -> str:
    """An FMU with an input u, an output y, a parameter c and a text t; Reals in one unit or none.

    It has no binary: nothing is run here.
    """
    known = f' unit="{unit}"' if unit else ""
    real = f'<Real start="0"{known}/>'
    defined = f'<Unit name="{unit}">{UNITS[unit]}</Unit>' if unit else ""
    return (
        '<fmiModelDescription fmiVersion="2.0" modelName="m" guid="{1}">'
        '<CoSimulation modelIdentifier="m"/>'
        + (f"<UnitDefinitions>{defined}</UnitDefinitions>" if unit else "")
        + "<ModelVariables>"
        f'<ScalarVariable name="u" valueReference="0" causality="input">{real}</ScalarVariable>'
        '<ScalarVariable name="y" valueReference="1" causality="output">'
        f"<Real{known}/></ScalarVariable>"
        '<ScalarVariable name="c" valueReference="2" causality="parameter" '
        f'variability="fixed">{real}</ScalarVariable>'
        '<ScalarVariable name="t" valueReference="3" causality="parameter" variability="fixed">'
        '<String start=""/></ScalarVariable>'
        '</ModelVariables><ModelStructure><Outputs><Unknown index="2"/></Outputs></ModelStructure>'
        "</fmiModelDescription>"
    )


def connector(name: str, kind: str, unit: str = "") -> str:
    stated = f' unit="{unit}"' if unit else ""
    return f'<ssd:Connector name="{name}" kind="{kind}"><ssc:Real{stated}/></ssd:Connector>'


def parameters(values: str, units: str = "") -> str:
    return (
        "<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues>"
        '<ssv:ParameterSet version="1.0" name="p"><ssv:Parameters>'
        f"{values}</ssv:Parameters>{units}</ssv:ParameterSet></ssd:ParameterValues>"
        "</ssd:ParameterBinding></ssd:ParameterBindings>"
    )


def parameter(name: str, value: str) -> str:
    return f'<ssv:Parameter name="{name}">{value}</ssv:Parameter>'


LINK = '<ssd:Connection startElement="a" startConnector="y" endElement="b" endConnector="u"/>'


def pair(
    folder: Path,
    *,
    fmu: str = "",
    outer: str = "",
    a: str = connector("y", "output"),
    b: str = connector("u", "input"),
    bound: str = "",
    attributes: str = "",
    links: str = LINK,
    units: str = "",
    version: str = "1.0",
) -> Scenario:
    """The scenario of an archive with two components a and b, of FMUs in the unit `fmu`."""
    parts = [
        HEAD.format(version=version, major=version[0]),
        '<ssd:System name="s">',
        f"<ssd:Connectors>{outer}</ssd:Connectors>" if outer else "",
        bound if "T" in bound else "",
        f'<ssd:Elements><ssd:Component name="a" source="m.fmu"{attributes}>',
        f"<ssd:Connectors>{a}</ssd:Connectors>",
        bound if "T" not in bound else "",
        '</ssd:Component><ssd:Component name="b" source="m.fmu">',
        f"<ssd:Connectors>{b}</ssd:Connectors></ssd:Component></ssd:Elements>",
        f"<ssd:Connections>{links}</ssd:Connections></ssd:System>",
        units,
        '<ssd:DefaultExperiment stopTime="1"/></ssd:SystemStructureDescription>',
    ]
    inner = folder / "m.fmu"
    with zipfile.ZipFile(inner, "w") as archive:
        archive.writestr("modelDescription.xml", description(fmu))
    file = folder / "pair.ssp"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("SystemStructure.ssd", "".join(parts))
        archive.write(inner, "m.fmu")
        archive.writestr("inside.csv", "0,1")
    return read_ssp(file)


def start(scenario: Scenario, name: str) -> dict[str, object]:
    (component,) = (c for c in scenario.system.components if c.name == name)
    return dict(component.start)


OUTER_LINK = '<ssd:Connection startConnector="T" endElement="{}" endConnector="u"/>'


@pytest.mark.parametrize(
    ("unit", "value", "expected"),
    [
        ("K", '<ssv:Real value="300"/>', 26.85),
        ("degC", '<ssv:Real value="300"/>', 300.0),
        ("degC", '<ssv:Real value="300" unit="K"/>', 26.85),
        ("", '<ssv:Real value="300"/>', 300.0),
    ],
)
def test_a_value_of_the_system_is_in_the_unit_of_its_connector(
    tmp_path: Path, unit: str, value: str, expected: float
) -> None:
    scenario = pair(
        tmp_path,
        fmu="degC",
        outer=connector("T", "input", unit),
        bound=parameters(parameter("T", value)),
        links=LINK + OUTER_LINK.format("a"),
        a=connector("y", "output") + connector("u", "input"),
    )
    assert start(scenario, "a")["u"] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("a", "b", "message"),
    [
        ("K", "degC", r"'a\.y -> b\.u': from 'K' to 'degC', where an FMU states no unit to"),
        ("kg", "m", r"'a\.y -> b\.u': 'kg' cannot become 'm'"),
        ("K", "K", None),
    ],
)
def test_units_that_connectors_alone_state(
    tmp_path: Path, a: str, b: str, message: str | None
) -> None:
    ends = {"a": connector("y", "output", a), "b": connector("u", "input", b)}
    if message is None:
        assert len(pair(tmp_path, **ends).system.connections) == 1
        return
    with pytest.raises(InvalidInput, match=message):
        pair(tmp_path, **ends)


@pytest.mark.parametrize(("unit", "factor", "expected"), [("K", 1000, 20_000.0), ("foo", 2, 40.0)])
def test_a_unit_is_what_the_archive_defines_it_to_be(
    tmp_path: Path, unit: str, factor: int, expected: float
) -> None:
    defined = (
        f'<ssv:Units><ssc:Unit name="{unit}"><ssc:BaseUnit K="1" factor="{factor}"/></ssc:Unit>'
        "</ssv:Units>"
    )
    value = parameter("c", f'<ssv:Real value="20" unit="{unit}"/>')
    scenario = pair(tmp_path, fmu="K", bound=parameters(value, defined))
    assert start(scenario, "a")["c"] == expected


@pytest.mark.parametrize("text", ["x" * 300, "/etc/passwd", "../m.fmu", "a\nb"])
def test_a_text_that_is_no_file_of_the_archive_stays_as_it_is(tmp_path: Path, text: str) -> None:
    shown = text.replace("\n", "&#10;")
    bound = parameters(parameter("t", f'<ssv:String value="{shown}"/>'))
    assert start(pair(tmp_path, bound=bound), "a")["t"] == text


def test_a_text_that_names_a_file_of_the_archive_leads_to_it(tmp_path: Path) -> None:
    bound = parameters(parameter("t", '<ssv:String value="inside.csv"/>'))
    assert Path(str(start(pair(tmp_path, bound=bound), "a")["t"])).read_text() == "0,1"


BOTH = connector("y", "output") + connector("u", "input")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"bound": parameters(2 * parameter("c", '<ssv:Real value="1"/>'))},
            "component 'a': parameter 'c' is given twice in one set",
        ),
        (
            {
                "bound": parameters(parameter("c", '<ssv:Real value="1"/>')).replace(
                    "<ssd:ParameterBinding>", '<ssd:ParameterBinding source="p.ssv">'
                )
            },
            r"component 'a': a binding with the source 'p\.ssv' and with values of its own",
        ),
        (
            {"attributes": ' implementation="ModelExchange"'},
            "component 'a' is to be run by model exchange",
        ),
        (
            {"b": connector("u", "output")},
            "component 'b': the connector 'u' is an output, the variable of the FMU an input",
        ),
        (
            {
                "outer": connector("T", "input") + connector("S", "parameter"),
                "links": OUTER_LINK.format("b") + OUTER_LINK.format("b").replace('"T"', '"S"'),
            },
            r"connector 'S' of the system: 'b\.u' is driven by 'T' already",
        ),
        (
            {"outer": connector("T", "output"), "links": OUTER_LINK.format("b")},
            r"connector 'T' of the system: it is an output, and 'b\.u' an input",
        ),
        (
            {
                "outer": connector("T", "input"),
                "links": OUTER_LINK.format("b").replace('"u"', '"v"'),
            },
            r"connector 'T' of the system: no connector 'b\.v'",
        ),
        (
            {
                "outer": connector("T", "input"),
                "links": LINK + OUTER_LINK.format("b"),
                "bound": parameters(parameter("T", '<ssv:Real value="1"/>')),
            },
            r"b\.u",
        ),
        ({"version": "2.0"}, r"the root is '\{http.*SSP2.*that of SSP 1\.0 is of the namespace"),
    ],
)
def test_what_contradicts_itself_is_refused(
    tmp_path: Path, changes: dict[str, str], message: str
) -> None:
    with pytest.raises(InvalidInput, match=message) as caught:
        pair(tmp_path, **changes)
    assert "\n" not in str(caught.value)


def test_a_connector_without_a_variable_is_named(tmp_path: Path) -> None:
    scenario = pair(tmp_path, b=connector("u", "input") + connector("v", "output"))
    assert any("no variable for the connector 'b.v'" in w for w in scenario.warnings)


def test_an_element_may_have_an_arrow_in_its_name(tmp_path: Path) -> None:
    scenario = pair(tmp_path)
    arrow = tmp_path / "arrow.ssp"
    with zipfile.ZipFile(tmp_path / "pair.ssp") as before, zipfile.ZipFile(arrow, "w") as after:
        for name in before.namelist():
            data = before.read(name)
            if name.endswith(".ssd"):
                data = data.replace(b'="a"', b'="a -&gt; c"')
            after.writestr(name, data)
    assert [c.name for c in read_ssp(arrow).system.components] == ["a_c", "b"]
    assert len(read_ssp(arrow).system.connections) == len(scenario.system.connections)


def test_an_fmu_inside_is_named_by_its_archive(tmp_path: Path) -> None:
    """And not by the folder in which it lies unpacked, which the user has not chosen."""
    with pytest.raises(InvalidInput) as told:
        pair(tmp_path, fmu="<")
    assert str(told.value).startswith(
        f"{tmp_path / 'pair.ssp'}: m.fmu: unreadable modelDescription.xml: "
    )
