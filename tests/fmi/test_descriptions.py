"""Model descriptions: what they say is read, what they cannot mean is refused with its place."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from congelation.cosim.pair_info import info
from congelation.cosim.system import Component, Connection, System
from congelation.errors import InvalidInput
from congelation.fmi.description import Description, describe
from congelation.fmi.info import fmu_info
from congelation.fmi.library import Message, binary
from congelation.fmi.start_values import resolve_start
from congelation.scenario.load import load_scenario
from tests.scenarios import FMUS
from tests.studies import command

XML = """<fmiModelDescription fmiVersion="2.0" modelName="m" guid="{g}">
<CoSimulation modelIdentifier="m"/>
<UnitDefinitions><Unit name="K"><BaseUnit K="1"/></Unit>
<Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit></UnitDefinitions>
<TypeDefinitions><SimpleType name="Difference"><Real unit="K" relativeQuantity="true"/></SimpleType>
<SimpleType name="A"><Enumeration><Item name="low" value="1"/></Enumeration></SimpleType>
<SimpleType name="B"><Enumeration><Item name="red" value="1"/></Enumeration></SimpleType>
</TypeDefinitions>
<ModelVariables>
<ScalarVariable name="u" valueReference="0" causality="input"><Real unit="degC" start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="1" causality="output"><Real unit="K" relativeQuantity="true"/></ScalarVariable>
<ScalarVariable name="z" valueReference="2" causality="output"><Real declaredType="Difference"/></ScalarVariable>
<ScalarVariable name="p" valueReference="3" causality="parameter" variability="fixed"><Real min="0" max="5" start="1"/></ScalarVariable>
<ScalarVariable name="k" valueReference="4" causality="parameter" variability="fixed"><Integer start="0"/></ScalarVariable>
<ScalarVariable name="s" valueReference="5" causality="input"><String start="old"/></ScalarVariable>
<ScalarVariable name="a" valueReference="6" causality="output" variability="discrete"><Enumeration declaredType="A"/></ScalarVariable>
<ScalarVariable name="b" valueReference="7" causality="input" variability="discrete"><Enumeration declaredType="B" start="1"/></ScalarVariable>
<ScalarVariable name="i" valueReference="8" causality="output" variability="discrete"><Integer/></ScalarVariable>
</ModelVariables><ModelStructure><Outputs><Unknown index="2" dependencies="1"/></Outputs></ModelStructure>
</fmiModelDescription>"""  # noqa: E501


def fmu(folder: Path, *change: str) -> Path:
    """The FMU, without a binary, with one change (old, new)."""
    text = XML.replace(*change) if change else XML
    assert not change or text != XML
    file = folder / "m.fmu"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", text)
    return file


@pytest.fixture
def m(tmp_path: Path) -> Description:
    return describe(fmu(tmp_path))


def test_a_difference_is_one_by_itself_or_by_its_type(m: Description) -> None:
    assert [name for name, v in m.variables.items() if v.relative] == ["y", "z"]


@pytest.mark.parametrize("output", ["y", "z"])
def test_the_offset_of_a_unit_is_not_that_of_a_difference(tmp_path: Path, output: str) -> None:
    """3 K more are 3 degC more, and not -270.15 degC."""
    file = fmu(tmp_path)
    system = System(
        (Component("one", file), Component("two", file)), (Connection(f"one.{output}", "two.u"),)
    )
    (link,) = system.resolve().links
    assert (link.factor, link.offset) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('guid="{g}"', "", r"states no guid"),
        ('modelIdentifier="m"', "", r"states no modelIdentifier"),
        ('modelIdentifier="m"', 'modelIdentifier=""', r"states no modelIdentifier"),
        (' fmiVersion="2.0"', "", r"states no fmiVersion; FMI 2\.0 is needed"),
        ('fmiVersion="2.0"', 'fmiVersion="2.0.4"', r"'2\.0\.4'; every FMU of FMI 2\.0 states"),
        ('<CoSimulation modelIdentifier="m"/>', "", r"neither co-simulation nor model exchange"),
        ('guid="{g}"', 'guid="{g}" xmlns="urn:a"', r"begins with '\{urn:a\}fmiModelDescription'"),
        (
            'valueReference="2"',
            'valueReference="4294967298"',
            r"line 12: .*valueReference.*'4294967298'",
        ),
        ('valueReference="2"', 'valueReference="-2"', r"line 12: .*valueReference.*'-2'"),
        ('valueReference="2"', "", r"line 12: .*'valueReference' is required"),
        ('valueReference="2"', 'valueReference="x"', r"line 12: .*valueReference.*'x'"),
        ('name="z"', "", r"line 12: .*'name' is required"),
        ('index="2"', 'index="0"', r"ModelStructure names the variable 0; there are 9"),
        ('index="2"', 'index="99"', r"ModelStructure names the variable 99"),
        ('dependencies="1"', 'dependencies="77"', r"names the variable 77"),
        ('dependencies="1"', 'dependencies="a"', r"line 19: .*dependencies.*'a'"),
        ('max="5"', 'max="five"', r"line 13: .*max.*'five'"),
        ('max="5"', 'max="5" nominal="abc"', r"line 13: .*nominal.*'abc'"),
        ('K="1" offset', 'K="one" offset', r"line 4: .*K.*'one'"),
        ('"Difference"/>', '"Distance"/>', r"Distance"),
        (
            "<fmiModelDescription",
            '<!DOCTYPE a [<!ENTITY e SYSTEM "file:///etc/passwd">]><fmiModelDescription',
            r"it declares a document type; files of FMI and SSP have none",
        ),
        ('name="k"', 'name="k&#10;x"', r"line 14: a variable's name has a line break"),
        ('"low" value="1"', '"low" value="99999999999"', r"line 6: .*value.*'99999999999'"),
    ],
)
def test_what_a_description_cannot_mean_is_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    file = fmu(tmp_path, old, new)
    with pytest.raises(InvalidInput, match=message) as caught:
        describe(file)
    assert str(caught.value).startswith(str(file))
    assert "\n" not in str(caught.value)


def test_a_unit_that_is_defined_twice_is_not_compared(tmp_path: Path) -> None:
    again = '<Unit name="K"><BaseUnit K="1" factor="2"/></Unit>'
    file = fmu(tmp_path, "</UnitDefinitions>", f"{again}</UnitDefinitions>")
    system = System(
        (Component("one", file), Component("two", file)), (Connection("one.y", "two.u"),)
    )
    (link,) = system.resolve().links
    assert link.doubt == "'K' and 'degC' cannot be compared"


def test_a_proposed_step_that_is_no_number_proposes_nothing(tmp_path: Path) -> None:
    step = '<DefaultExperiment stepSize="abc"/>'
    file = fmu(tmp_path, "<ModelVariables>", f"{step}<ModelVariables>")
    assert describe(file).proposed_step is None
    assert "abc" not in str(info(file))


def test_numbers_of_32_bits_are_taken_to_the_last(m: Description) -> None:
    (start,) = resolve_start(m, {"k": -(2**31)}, "here")
    assert start.value == -(2**31)
    for value in (-(2**31) - 1, 2**31):
        with pytest.raises(InvalidInput, match="does not fit in 32 bits"):
            resolve_start(m, {"k": value}, "here")


def test_a_text_with_a_zero_is_refused(m: Description) -> None:
    with pytest.raises(InvalidInput, match=r"'a\\x00b' has a zero"):
        resolve_start(m, {"s": "a\0b"}, "here")


def test_enumerations_of_other_items_are_not_connected(tmp_path: Path) -> None:
    file = fmu(tmp_path)
    ends = (Component("one", file), Component("two", file))
    with pytest.raises(InvalidInput, match=r"different items: 'low' \(1\) and 'red' \(1\)"):
        System(ends, (Connection("one.a", "two.b"),)).resolve()
    (link,) = System(ends, (Connection("one.i", "two.b"),)).resolve().discrete_links
    assert link.doubt == "'i' is an Integer, which may be no item of the enumeration 'b'"


def test_a_start_value_out_of_range_and_a_text_left_open(tmp_path: Path) -> None:
    fmu(tmp_path)
    file = tmp_path / "s.toml"
    file.write_text(
        'title = "s"\nopen = ["m.s", "m.u", "m.b"]\n'
        '[components.m]\nfmu = "m.fmu"\nstart = {p = 9}\n'
        "[experiment]\nstop_time = 1\nstep = 0.1\n[[variants]]\n"
        'name = "low"\nset = {"m.p" = -1}\n',
        encoding="utf-8",
    )
    assert load_scenario(file).warnings == (
        f"{file}: component 'm': 'm.p' = 9, where its FMU states max = 5",
        f"{file}: variant 'low': 'm.p' = -1, where its FMU states min = 0",
    )


def test_elements_that_count_from_0(tmp_path: Path) -> None:
    """As those of C do; a list gives all of them, and one element is no vector."""
    counted = (
        '<ScalarVariable name="p" valueReference="3"',
        '<ScalarVariable name="v[0]" valueReference="9" causality="input"><Real start="0"/>'
        '</ScalarVariable><ScalarVariable name="v[1]" valueReference="10" causality="input">'
        '<Real start="0"/></ScalarVariable><ScalarVariable name="p" valueReference="3"',
    )
    known = describe(fmu(tmp_path, *counted))
    found = resolve_start(known, {"v": [5.0, 6.0]}, "here")
    assert {start.variable.name: start.value for start in found} == {"v[0]": 5.0, "v[1]": 6.0}
    for value in (5.0, [5.0]):
        with pytest.raises(InvalidInput, match="2 values needed"):
            resolve_start(known, {"v": value}, "here")


@pytest.mark.parametrize(
    ("text", "line"),
    [("a\x1b[31m b", "a\\x1b[31m b"), (" one\n two ", "one two"), ("2 \u00b0C", "2 \u00b0C")],
)
def test_messages_are_one_line_that_no_terminal_obeys(text: str, line: str) -> None:
    assert Message(2, "", text).line == line


@pytest.mark.parametrize("all_of_them", [False, True])
def test_what_is_declared_discrete_throughout_is_continuous(
    tmp_path: Path, all_of_them: bool
) -> None:
    """Some tools declare positions and speeds so; it says something where it is not of all."""
    copy = tmp_path / "copy.fmu"
    with zipfile.ZipFile(FMUS / "ScalarPlant.fmu") as given, zipfile.ZipFile(copy, "w") as made:
        for name in given.namelist():
            content = given.read(name)
            if name == "modelDescription.xml":
                old, new = b'variability="continuous"', b'variability="discrete"'
                content = content.replace(old, new, -1 if all_of_them else 1)
            made.writestr(name, content)
    held = [v for v in describe(copy).variables.values() if v.variability == "discrete"]
    assert held
    assert {v.is_held for v in held} == {not all_of_them}


def test_info_shows_ranges_items_and_where_an_fmu_cannot_be_run(tmp_path: Path) -> None:
    file = fmu(tmp_path)
    with zipfile.ZipFile(file, "a") as archive:
        archive.writestr("binaries/other64/m.bin", b"")
    found = fmu_info(file)
    (bounded, _) = found.parameters
    assert (bounded.least, bounded.most, bounded.range) == (0.0, 5.0, "from 0 to 5")
    assert {v.name: v.items for v in found.outputs}["a"] == {"low": 1}
    assert found.missing == binary("m")
    done = command("info", file)
    assert done.returncode == 0
    assert f"it cannot be run here: it has no binary {binary('m')}; there is other64/m.bin" in (
        done.stdout
    )
    assert "low = 1" in done.stdout
    assert fmu_info(FMUS / "ScalarPlant.fmu").missing == ""


def test_two_python_fmus_with_one_module_name_are_told_apart(tmp_path: Path) -> None:
    """A process can import one module of a name: the second FMU would run the first one's code."""
    other = tmp_path / "Other.fmu"
    with (
        zipfile.ZipFile(FMUS / "ScalarPlant.fmu") as old,
        zipfile.ZipFile(other, "w") as new,
    ):
        module = old.read("resources/slavemodule.txt").decode().strip()
        for name in old.namelist():
            end = b"\n# another model\n" if name == f"resources/{module}.py" else b""
            new.writestr(name, old.read(name) + end)
    scenario = tmp_path / "two.toml"
    parts = "".join(
        f'[components.{name}]\nfmu = "{file}"\nstart = {{u = 0.0}}\n'
        for name, file in (("a", FMUS / "ScalarPlant.fmu"), ("b", other))
    )
    scenario.write_text(f'title = "Two"\n{parts}[experiment]\nstop_time = 0.1\nstep = 0.01\n')
    done = command("run", scenario, "--out", tmp_path / "out", "--progress", "quiet")
    assert done.returncode == 2
    assert f"different modules of one name, '{module}.py'" in done.stderr.splitlines()[-1]
