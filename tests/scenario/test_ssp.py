"""SSP archives: what is written is valid and read back as it was; what is wrong is said."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssd
from lxml import etree
from scipy.linalg import expm

from congelation.cosim.experiment import Experiment
from congelation.cosim.system import Component, Connection, System
from congelation.errors import InvalidInput
from congelation.results.results import Results
from congelation.scenario.load import load_scenario
from congelation.scenario.scenario import Scenario
from congelation.scenario.ssp import read_ssp, write_ssp
from congelation.sweep.engine import run
from tests.cosim.c_fmus import plain_fmu
from tests.scenarios import FMUS, SCALAR, SHIPPED, write
from tests.studies import last_line as one_line
from tests.studies import process as congelation

SSD = "SystemStructure.ssd"
SSV = "resources/plant.ssv"


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """A valid archive: the scalar loop, Controller 1."""
    file = tmp_path / "loop.ssp"
    write_ssp(load_scenario(write(tmp_path)), file)
    return file


def contents(file: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(file) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def pack(file: Path, entries: Mapping[str, bytes]) -> Path:
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return file


def changed(file: Path, name: str, *changes: tuple[str, str]) -> Path:
    """A copy of an archive with every change (old, new) made to one of its files."""
    entries = contents(file)
    text = entries[name].decode()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return pack(file.with_name("changed.ssp"), {**entries, name: text.encode()})


def without_annotations(file: Path) -> Path:
    """A copy of an archive as another tool might have written it."""
    entries = contents(file)
    root = etree.fromstring(entries[SSD])
    for element in root.findall(".//{*}Annotations"):
        element.getparent().remove(element)
    return pack(file.with_name("plain.ssp"), {**entries, SSD: etree.tostring(root)})


def start(scenario: Scenario, component: str) -> Mapping[str, object]:
    return next(c.start for c in scenario.system.components if c.name == component)


def links(system: System) -> list[str]:
    resolved = system.resolve()
    return [link.name for link in (*resolved.links, *resolved.discrete_links)]


def with_contents(start: Mapping[str, object]) -> dict[str, object]:
    """Start values with what is in a table's file in place of its name: archives hold a copy."""
    return {
        name: Path(str(value)).read_bytes() if name.endswith("table.file") and value else value
        for name, value in start.items()
    }


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_what_is_written_is_valid_and_read_back_as_it_was(file: Path, tmp_path: Path) -> None:
    scenario = load_scenario(file)
    schemas = Path(fmpy.__file__).parent / "ssp" / "schema"
    for variant in scenario.variants:
        target = tmp_path / f"{file.stem}.ssp"
        write_ssp(scenario, target, variant.name)
        for name, content in contents(target).items():
            kinds = {".ssd": "SystemStructureDescription", ".ssv": "SystemStructureParameterValues"}
            if Path(name).suffix in kinds:
                schema = etree.XMLSchema(file=schemas / f"{kinds[Path(name).suffix]}.xsd")
                schema.assertValid(etree.fromstring(content))
        again = read_ssp(target)
        expected = scenario.case(variant.settings)
        found = again.case(again.variants[0].settings)
        assert found.experiment == expected.experiment
        for component, other in zip(
            expected.system.components, found.system.components, strict=True
        ):
            stated = {name: value for name, value in component.start.items() if value != ""}
            assert other.name == component.name
            assert with_contents(other.start) == with_contents(stated)
            assert other.fmu.read_bytes() == component.fmu.read_bytes()
        assert links(found.system) == links(expected.system)
        assert [v.name for v in again.variants] == [variant.name]
        assert again.title == scenario.title
        assert again.metrics == scenario.metrics
        assert again.figures == scenario.figures


def test_an_archive_runs_as_its_scenario_does(archive: Path, tmp_path: Path) -> None:
    here = run(tmp_path / "loop.toml", out=tmp_path / "toml")
    there = run(archive, out=tmp_path / "ssp")

    def first(results: Results) -> tuple[dict[str, object], np.ndarray]:
        found = results.runs[0]
        return found.row(), results.trajectory(found.run_id).values

    (row, values), (other_row, other_values) = first(here), first(there)
    assert row["status"] == "COMPLETED"
    assert np.array_equal(values, other_values)
    for column in ("variant", "metric.peak_x", "metric.settling_x", "fmu.plant", "fmu.controller"):
        assert row[column] == other_row[column]


def test_equal_scenarios_give_equal_bytes(archive: Path, tmp_path: Path) -> None:
    before = archive.read_bytes()
    write_ssp(load_scenario(tmp_path / "loop.toml"), archive, "Controller 1")
    assert archive.read_bytes() == before
    write_ssp(load_scenario(tmp_path / "loop.toml"), archive, "Controller 2")
    assert archive.read_bytes() != before


def test_another_tool_finds_components_connectors_and_parameters(archive: Path) -> None:
    system = read_ssd(str(archive)).system
    connectors = {c.name: {k.name: k.kind for k in c.connectors} for c in system.elements}
    assert connectors == {
        "plant": {"u": "input", "x": "output"},
        "controller": {"x": "input", "u": "output", "theta_hat[1]": "output"},
    }
    sets = [c.parameterBindings[0].parameterValues[0] for c in system.elements]
    assert {s.name for s in sets} == {"initialValues"}
    assert {p.name: p.value for p in sets[1].parameters}["damping"] == "true"


def test_derivatives_are_connected_on_request(archive: Path, tmp_path: Path) -> None:
    write_ssp(load_scenario(tmp_path / "loop.toml"), archive, derivatives=True)
    ends = {
        (c.startElement, c.startConnector, c.endElement, c.endConnector)
        for c in read_ssd(str(archive)).system.connections
    }
    assert ends == {
        ("plant", "x", "controller", "x"),
        ("controller", "u", "plant", "u"),
        ("plant", "der(x)", "controller", "der(x)"),
        ("controller", "der(u)", "plant", "der(u)"),
    }
    assert links(read_ssp(archive).system) == links(
        load_scenario(tmp_path / "loop.toml").system
    )  # the master connects derivatives by itself


@pytest.mark.filterwarnings("ignore:.*read from a table")  # of what cannot be known of theta
def test_a_table_travels_with_the_archive(tmp_path: Path) -> None:
    table = tmp_path / "theta.csv"
    table.write_text("time,theta\n0,-3\n0.4,-2\n1,-3\n")
    old = "{constant = -3.0}, {square = {amplitude = 0.4, period = 0.3}}"
    scenario = load_scenario(
        write(tmp_path, SCALAR, (old, '{table = {file = "theta.csv", linear = true}}'))
    )
    expected = run(scenario, out=tmp_path / "toml").runs[0]
    write_ssp(scenario, tmp_path / "loop.ssp")
    table.unlink()
    found = run(tmp_path / "loop.ssp", out=tmp_path / "ssp").runs[0]
    assert found.status == "COMPLETED"
    assert found.metrics["peak_x"] == expected.metrics["peak_x"]


def test_files_of_one_name_are_kept_apart(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    other = tmp_path / "other" / "ScalarController.fmu"
    other.write_bytes((FMUS / "ScalarPlant.fmu").read_bytes())
    extra = (
        "[experiment]",
        f"[components.twin]\nfmu = '{other}'\n[components.twin.start]\nx0 = [0.5]\n[experiment]",
    )
    write_ssp(load_scenario(write(tmp_path, SCALAR, extra)), tmp_path / "loop.ssp")
    found = {c.name: c.fmu for c in read_ssp(tmp_path / "loop.ssp").system.components}
    assert found["twin"].read_bytes() == found["plant"].read_bytes()
    assert found["controller"].read_bytes() == (FMUS / "ScalarController.fmu").read_bytes()
    assert start(read_ssp(tmp_path / "loop.ssp"), "twin") == {"x0[1]": 0.5}


@pytest.mark.parametrize(
    ("variant", "name", "text"),
    [
        ("Controler 1", "loop.ssp", "no variant 'Controler 1'; did you mean 'Controller 1'?"),
        (None, "loop.zip", "the name of an SSP archive ends in .ssp"),
    ],
)
def test_what_cannot_be_written(tmp_path: Path, variant: str | None, name: str, text: str) -> None:
    with pytest.raises(InvalidInput, match=re.escape(text)):
        write_ssp(load_scenario(write(tmp_path)), tmp_path / name, variant)
    assert not (tmp_path / name).exists()


def test_archives_of_other_tools_are_run_to_a_tolerance(archive: Path) -> None:
    scenario = read_ssp(without_annotations(archive))
    experiment = scenario.case({}).experiment
    assert (experiment.stop_time, experiment.step, experiment.tolerance) == (1.0, None, 1e-6)
    assert [v.name for v in scenario.variants] == ["plain"]
    assert scenario.title == "A short loop"
    assert "plant.x" in experiment.record


def test_a_linear_pair_of_held_inputs_takes_tens_of_steps(tmp_path: Path) -> None:
    """x' = -x + w, x(0) = 1, and w' = -3 w - 2 x, each an FMU without derivatives, over 1 s."""
    fmu = plain_fmu(tmp_path)
    pair = Scenario(
        title="A pair",
        system=System(
            (
                Component("p", fmu, {"a": -1.0, "b1": 1.0, "x0": 1.0, "u2": 0.0}),
                Component("c", fmu, {"a": -3.0, "b1": -2.0, "u2": 0.0}),
            ),
            (Connection("p.y", "c.u1"), Connection("c.y", "p.u1")),
        ),
        experiment=Experiment(stop_time=1.0, step=0.1),
    )
    write_ssp(pair, tmp_path / "pair.ssp")
    found = read_ssp(without_annotations(tmp_path / "pair.ssp"))
    assert found.experiment.step is None
    assert found.experiment.tolerance == 1e-4
    results = run(found, out=tmp_path / "out")
    (row,) = results.runs
    assert row.status == "COMPLETED"
    assert row.steps is not None
    assert 10 <= row.steps < 60
    trajectory = results.trajectory(row.run_id)
    end = dict(zip(trajectory.columns, trajectory.values[-1], strict=True))
    exact = expm(np.array([[-1.0, 1.0], [-2.0, -3.0]])) @ [1.0, 0.0]
    assert [end["p.y"], end["c.y"]] == pytest.approx(exact, abs=1e-3)


def test_what_nobody_listens_to_is_as_accurate(tmp_path: Path) -> None:
    """x' = -3 x, x(0) = 1, and behind it w' = -w + x: w(1) = (e^-1 - e^-3) / 2."""
    fmu = plain_fmu(tmp_path)
    chain = Scenario(
        title="A chain",
        system=System(
            (
                Component("s", fmu, {"a": -3.0, "x0": 1.0, "u1": 0.0, "u2": 0.0}),
                Component("i", fmu, {"a": -1.0, "b1": 1.0, "u2": 0.0}),
            ),
            (Connection("s.y", "i.u1"),),
        ),
        experiment=Experiment(stop_time=1.0, step=0.1),
    )
    write_ssp(chain, tmp_path / "chain.ssp")
    found = read_ssp(without_annotations(tmp_path / "chain.ssp"))
    assert found.experiment.tolerance == 1e-4
    results = run(found, out=tmp_path / "out")
    (row,) = results.runs
    trajectory = results.trajectory(row.run_id)
    end = dict(zip(trajectory.columns, trajectory.values[-1], strict=True))
    assert end["i.y"] == pytest.approx((np.exp(-1.0) - np.exp(-3.0)) / 2.0, abs=1e-3)


def test_fmus_that_cannot_step_back_have_their_steps_predicted(
    archive: Path, tmp_path: Path
) -> None:
    plain = without_annotations(archive)
    fmu = tmp_path / "ScalarPlant.fmu"
    fmu.write_bytes(contents(plain)["resources/ScalarPlant.fmu"])
    entries = contents(fmu)
    xml = entries["modelDescription.xml"]
    assert b'canGetAndSetFMUstate="true"' in xml
    entries["modelDescription.xml"] = xml.replace(
        b'canGetAndSetFMUstate="true"', b'canGetAndSetFMUstate="false"'
    )
    pack(fmu, entries)
    file = pack(plain, {**contents(plain), "resources/ScalarPlant.fmu": fmu.read_bytes()})
    scenario = read_ssp(file)
    experiment = scenario.case({}).experiment
    assert (experiment.coupling, experiment.step, experiment.tolerance) == ("auto", None, 1e-6)
    (row,) = run(scenario, out=tmp_path / "out").runs
    assert (row.status, row.coupling) == ("COMPLETED", "derivative")
    assert row.coupling_why is not None
    assert "not all FMUs can save their state" in row.coupling_why


def test_the_kinds_of_the_connectors_tell_the_direction(archive: Path) -> None:
    turned = changed(
        archive,
        SSD,
        (
            'startElement="plant" startConnector="x" endElement="controller" endConnector="x"',
            'startElement="controller" startConnector="x" endElement="plant" endConnector="x"',
        ),
    )
    assert links(read_ssp(turned).system) == links(read_ssp(archive).system)


def surroundings(kind: str) -> str:
    """The connector x of the system."""
    connector = f'<ssd:Connector name="x" kind="{kind}"><ssc:Real/></ssd:Connector>'
    return f"<ssd:Connectors>{connector}</ssd:Connectors>"


OUTER = '<ssd:Connection startConnector="x" endElement="controller" endConnector="x"/>'


def of_the_system(archive: Path, kind: str, name: str | None) -> Path:
    """The archive with controller.x connected to a connector of the system, x, instead."""
    entries = contents(archive)
    root = etree.fromstring(entries[SSD])
    for connection in root.findall(".//{*}Connection[@endElement='controller']"):
        connection.getparent().remove(connection)
    file = pack(archive.with_name("outer.ssp"), {**entries, SSD: etree.tostring(root)})
    value = (
        "<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues><ssv:ParameterSet "
        'version="1.0" name="p"><ssv:Parameters>'
        f'<ssv:Parameter name="{name}"><ssv:Real value="0.25"/></ssv:Parameter>'
        "</ssv:Parameters></ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding>"
        "</ssd:ParameterBindings>"
    )
    return changed(
        file,
        SSD,
        ("<ssd:Connections>", f"<ssd:Connections>{OUTER}"),
        ("<ssd:Elements>", f"{surroundings(kind)}{value if name else ''}<ssd:Elements>"),
    )


@pytest.mark.parametrize("kind", ["input", "parameter"])
def test_a_value_of_a_connector_of_the_system_takes_effect(archive: Path, kind: str) -> None:
    scenario = read_ssp(of_the_system(archive, kind, "x"))
    assert start(scenario, "controller")["x"] == 0.25
    assert scenario.warnings == ()


def test_an_input_of_the_system_without_a_value_is_open(archive: Path) -> None:
    scenario = read_ssp(of_the_system(archive, "input", None))
    assert scenario.open == ("controller.x",)
    assert scenario.warnings == ()


def test_a_parameter_without_a_variable_is_named(archive: Path) -> None:
    file = of_the_system(archive, "input", "y")
    (warning,) = read_ssp(file).warnings
    assert warning == f"{file}: there is no variable for the parameter 'y'"


def test_a_connection_with_no_connector_of_the_system_is_refused(archive: Path) -> None:
    file = changed(archive, SSD, ("<ssd:Connections>", f"<ssd:Connections>{OUTER}"))
    with pytest.raises(InvalidInput, match="with the connector 'x' of the system: it has none"):
        read_ssp(file)


@pytest.mark.parametrize("tool", ["com.opensimulationplatform", "org.openmodelica"])
def test_a_step_that_other_tools_read_is_read(tmp_path: Path, tool: str) -> None:
    file = tmp_path / "loop.ssp"
    write_ssp(load_scenario(write(tmp_path)), file, step=0.02)
    entries = contents(file)
    root = etree.fromstring(entries[SSD])
    for element in root.findall(".//{*}Annotation"):
        if element.get("type") != tool:
            element.getparent().remove(element)
    for element in root.findall(".//{*}Annotations"):
        if len(element) == 0 and element.tag.startswith("{http://ssp"):
            element.getparent().remove(element)
    plain = pack(tmp_path / "plain.ssp", {**entries, SSD: etree.tostring(root)})
    experiment = read_ssp(plain).experiment
    assert (experiment.coupling, experiment.step, experiment.tolerance) == ("jacobi", 0.02, None)
    bad = changed(plain, SSD, ('"0.02"', '"-1"'))
    with pytest.raises(InvalidInput, match=r"= '-1' is not a positive time"):
        read_ssp(bad)


def test_no_empty_string_is_written(archive: Path) -> None:
    assert (
        start(load_scenario(archive.with_name("loop.toml")), "plant")["profile[1].table.file"] == ""
    )
    assert b"ssv:String" not in contents(archive)[SSV]


def test_connections_with_the_surroundings_are_left_open(archive: Path) -> None:
    outer = '<ssd:Connection startElement="plant" startConnector="x" endConnector="x"/>'
    opened = changed(
        archive,
        SSD,
        ("<ssd:Connections>", f"<ssd:Connections>{outer}"),
        ("<ssd:Elements>", f"{surroundings('output')}<ssd:Elements>"),
    )
    assert links(read_ssp(opened).system) == links(read_ssp(archive).system)


def test_parameters_by_the_rules_of_ssp(archive: Path) -> None:
    """Later bindings win, the system's over the component's; unknown names are ignored."""

    def values(pairs: Mapping[str, float]) -> str:
        parameters = "".join(
            f'<ssv:Parameter name="{n}"><ssv:Real value="{v}"/></ssv:Parameter>'
            for n, v in pairs.items()
        )
        return (
            '<ssd:ParameterValues><ssv:ParameterSet version="1.0" name="inline">'
            f"<ssv:Parameters>{parameters}</ssv:Parameters></ssv:ParameterSet>"
            "</ssd:ParameterValues>"
        )

    def binding(pairs: Mapping[str, float], prefix: str = "") -> str:
        return f'<ssd:ParameterBinding prefix="{prefix}">{values(pairs)}</ssd:ParameterBinding>'

    own = '<ssd:ParameterBinding source="resources/controller.ssv"/>'
    later = binding({"epsilon": 0.4, "k_bar": 0.6, "nothing": 1.0})
    of_system = binding({"k_bar": 0.7, "nobody": 2.0}, prefix="controller.")
    file = changed(
        archive,
        SSD,
        (own, own + later),
        (
            "<ssd:Elements>",
            f"<ssd:ParameterBindings>{of_system}</ssd:ParameterBindings><ssd:Elements>",
        ),
    )
    expected = {**start(read_ssp(archive), "controller"), "epsilon": 0.4, "k_bar": 0.7}
    assert start(read_ssp(file), "controller") == expected


def test_a_unit_has_to_be_of_the_kind_of_the_fmus(archive: Path) -> None:
    def in_unit(unit: str) -> Path:
        return changed(
            archive, SSV, ('<ssv:Real value="0.3"/>', f'<ssv:Real value="0.3" unit="{unit}"/>')
        )

    own = start(read_ssp(archive), "plant")
    assert start(read_ssp(in_unit("s")), "plant") == own
    (changed_name,) = (
        n for n, v in start(read_ssp(in_unit("min")), "plant").items() if v != own[n]
    )
    assert (own[changed_name], start(read_ssp(in_unit("min")), "plant")[changed_name]) == (
        0.3,
        18.0,
    )
    with pytest.raises(
        InvalidInput, match=r"unit = 'kg' is not the unit of .*; give one such as 's'"
    ):
        read_ssp(in_unit("kg"))


@pytest.mark.parametrize(
    ("unit", "message"),
    [
        ("s", None),
        (
            "min",
            r"component 'plant': the connector '.*period' is in 'min', .* in 's'; give the FMU",
        ),
        ("kg", r"component 'plant': the connector '.*period' is in 'kg', .* in 's'; give the FMU"),
    ],
)
def test_a_connector_of_another_unit_is_refused(
    archive: Path, unit: str, message: str | None
) -> None:
    connector = (
        '<ssd:Connector name="profile[1].square[1].period" kind="parameter">'
        f'<ssc:Real unit="{unit}"/></ssd:Connector>'
    )
    file = changed(archive, SSD, ("<ssd:Connectors>", "<ssd:Connectors>" + connector))
    if message is None:
        assert start(read_ssp(file), "plant") == start(read_ssp(archive), "plant")
        return
    with pytest.raises(InvalidInput, match=message):
        read_ssp(file)


CONNECTION = 'startElement="plant" startConnector="x" endElement="controller" endConnector="x"/>'
COMPONENT = 'source="resources/ScalarPlant.fmu"'
BINDING = '<ssd:ParameterBinding source="resources/plant.ssv"'


@pytest.mark.parametrize(
    ("name", "old", "new", "text"),
    [
        (SSD, 'kind="input"', 'kind="inputt"', "SystemStructure.ssd, line 7: Element "),
        (SSD, "</ssd:System>", "", "SystemStructure.ssd: no XML: "),
        (SSV, '<ssv:Real value="1.0"/>', '<ssv:Real value="one"/>', "resources/plant.ssv, line "),
        (SSD, COMPONENT, 'source="resources/Plant.fmu"', "component 'plant': there is no 'reso"),
        (SSD, COMPONENT, 'source="../loop.toml"', "component 'plant': there is no '../loop.toml'"),
        (
            SSD,
            COMPONENT,
            COMPONENT + ' type="application/x-ssp-package"',
            "component 'plant' is no FMU",
        ),
        (SSD, '"controller" source', '"plant" source', "component 'plant' is given twice"),
        (
            SSD,
            "</ssd:Elements>",
            '<ssd:System name="inner"/></ssd:Elements>',
            "component 'inner' is no FMU; only systems of FMUs can be run",
        ),
        (
            SSD,
            CONNECTION,
            CONNECTION.replace('"x"', '"y"', 1),
            "connection 'plant.y -> controller.x': no connector 'plant.y'; did you mean 'plant.x'?",
        ),
        (
            SSD,
            CONNECTION,
            CONNECTION[:-2] + '><ssc:LinearTransformation factor="2"/></ssd:Connection>',
            "connection 'plant.x -> controller.x': a transformation; put it into an FMU",
        ),
        (
            SSD,
            CONNECTION,
            CONNECTION.replace('"plant" startConnector="x"', '"plant" startConnector="u"'),
            "connection 'plant.u -> controller.x': give an output and an input",
        ),
        (
            SSD,
            CONNECTION,
            CONNECTION[:-2] + ' suppressUnitConversion="true"/>',
            "connection 'plant.x -> controller.x': suppressUnitConversion; units are always",
        ),
        (
            SSD,
            '<ssd:Connector name="u" kind="input">\n            <ssc:Real/>',
            '<ssd:Connector name="u" kind="input">\n            <ssc:Integer/>',
            "component 'plant': the connector 'u' is of type Integer, the variable of the FMU of "
            "type Real; give the FMU's",
        ),
        (
            SSD,
            BINDING,
            BINDING + ' type="text/csv"',
            "component 'plant': parameters of type 'text/csv'",
        ),
        (
            SSD,
            BINDING,
            BINDING + ' sourceBase="component"',
            "component 'plant': parameters inside of",
        ),
        (
            SSD,
            BINDING + "/>",
            BINDING + "><ssd:ParameterMapping/></ssd:ParameterBinding>",
            "component 'plant': a parameter mapping",
        ),
        (SSD, BINDING, BINDING.replace("plant.ssv", "p.ssv"), "there is no 'resources/p.ssv'"),
        (SSV, '<ssv:Real value="1.0"/>', '<ssv:Binary value="00"/>', "is a value of type Binary"),
        (SSV, '<ssv:Real value="1.0"/>', '<ssv:String value="1"/>', "'1' given, a number needed"),
        (SSD, '"title": ', '"title ', "annotation 'congelation': no JSON"),
        (SSD, '"metrics": {', '"metrix": {', "metrix is not known here; did you mean 'metrics'?"),
        (SSD, '"coupling": "auto"', '"coupling": "jacoby"', "experiment.coupling"),
    ],
)
def test_what_cannot_be_read_is_said_in_one_line(
    archive: Path, name: str, old: str, new: str, text: str
) -> None:
    file = changed(archive, name, (old, new))
    with pytest.raises(InvalidInput) as caught:
        read_ssp(file)
    assert text in str(caught.value)
    assert str(caught.value).startswith(str(file))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", ["[" * 99_999, "9" * 5001], ids=["deep", "long"])
def test_an_annotation_that_json_cannot_hold_is_one_line(archive: Path, value: str) -> None:
    file = changed(archive, SSD, ('"title": ', f'"more": {value}, "title": '))
    with pytest.raises(InvalidInput, match="annotation 'congelation': no JSON"):
        read_ssp(file)


def test_what_is_no_archive(archive: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="no such file; give the path of an SSP archive"):
        read_ssp(tmp_path / "absent.ssp")
    archive.write_bytes(archive.read_bytes()[:-100])
    with pytest.raises(InvalidInput, match="is not an SSP archive: File is not a zip file"):
        read_ssp(archive)
    with pytest.raises(InvalidInput, match=r"no 'SystemStructure\.ssd' in the archive"):
        read_ssp(pack(archive, {"readme.txt": b""}))


def test_a_stop_time_is_needed(archive: Path) -> None:
    file = changed(without_annotations(archive), SSD, (' stopTime="1.0"', ""))
    with pytest.raises(InvalidInput, match="DefaultExperiment: stopTime is missing"):
        read_ssp(file)


def test_the_commands(tmp_path: Path) -> None:
    write(tmp_path)
    done = congelation(
        "export-ssp", "loop.toml", "c2.ssp", "--variant", "Controller 2", cwd=tmp_path
    )
    assert (done.returncode, done.stdout) == (0, "c2.ssp\n"), done.stderr
    done = congelation("run", "c2.ssp", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Controller 2" in done.stdout
    assert "peak_x" in done.stdout
    assert (tmp_path / "results" / "c2" / "runs.parquet").is_file()
    assert (tmp_path / "results" / "c2" / "figures" / "loop.png").is_file()
    line = one_line(congelation("run", "absent.ssp", cwd=tmp_path), 2)
    assert line.startswith("congelation: absent.ssp: no such file")


def test_a_scenario_with_a_sweep_and_a_tolerance(tmp_path: Path) -> None:
    """One variant of it is exported, whatever the axes are of; a tolerance is no step."""
    axis = """
[[sweep.axes]]
set = "controller.epsilon"
values = [0.7, 1.0]
variants = ["Controller 2"]
"""
    write(tmp_path, SCALAR + axis, ("step = 0.01", "tolerance = 1e-6"))
    done = congelation("export-ssp", "loop.toml", "sweep.ssp", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, "sweep.ssp\n"), done.stderr
    assert done.stderr == (
        "congelation: the archive states no step for other tools, as the scenario has a "
        "tolerance; --step gives one\n"
    )
    assert read_ssp(tmp_path / "sweep.ssp").sweep is None
    done = congelation("export-ssp", "loop.toml", "sweep.ssp", "--step", "1e-3", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


def test_native_fmus_take_the_place_of_those_of_the_scenario(tmp_path: Path) -> None:
    write(tmp_path)
    done = congelation("export-ssp", "loop.toml", "native.ssp", "--native", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    entries = contents(tmp_path / "native.ssp")
    for name in ("ScalarPlant.fmu", "ScalarController.fmu"):
        assert entries[f"resources/{name}"] == (FMUS / "native" / name).read_bytes()
    # Those are taken as they are, where the scenario names them itself.
    write_ssp(read_ssp(tmp_path / "native.ssp"), tmp_path / "again.ssp")
    assert (
        contents(tmp_path / "again.ssp")["resources/ScalarPlant.fmu"]
        == (FMUS / "native" / "ScalarPlant.fmu").read_bytes()
    )


def test_a_native_fmu_that_is_not_there_is_named(archive: Path) -> None:
    with pytest.raises(
        InvalidInput, match=r"component 'plant': no native FMU at .*native/ScalarPlant\.fmu; build"
    ):
        write_ssp(read_ssp(archive), archive.with_name("native.ssp"), native=True)


@pytest.mark.parametrize("name", ["the plant", "plant.of.mine", "plant\t1"])
def test_an_element_may_have_blanks_and_dots_in_its_name(archive: Path, name: str) -> None:
    shown = name.replace("\t", "&#9;")
    file = changed(
        archive,
        SSD,
        ('"plant.', '"' + re.sub(r"\W", "_", name) + "."),  # in what is recorded and measured
        ('name="plant"', f'name="{shown}"'),
        ('startElement="plant"', f'startElement="{shown}"'),
        ('endElement="plant"', f'endElement="{shown}"'),
    )
    scenario, plain = read_ssp(file), re.sub(r"\W", "_", name)
    assert [c.name for c in scenario.system.components] == [plain, "controller"]
    assert f"{plain}.x -> controller.x" in map(str, scenario.system.connections)
    assert scenario.system.components[0].start["x0[1]"] == 1.0
    assert scenario.warnings == (f"{file}: the element '{name}' is called '{plain}' here",)
