"""Enumerations take the names of their items, and nothing that is no item."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from congelation.errors import InvalidInput
from congelation.fmi.description import Description, describe
from congelation.fmi.start_values import resolve_start

XML = """<fmiModelDescription fmiVersion="2.0" modelName="Gear" guid="{g}">
<CoSimulation modelIdentifier="Gear"/>
<TypeDefinitions><SimpleType name="Position"><Enumeration>
<Item name="reverse" value="-1"/><Item name="neutral" value="0"/><Item name="drive" value="4"/>
</Enumeration></SimpleType></TypeDefinitions>
<ModelVariables>
<ScalarVariable name="gear" valueReference="0" causality="parameter" variability="tunable">
<Enumeration declaredType="Position" start="0"/></ScalarVariable>
</ModelVariables><ModelStructure/></fmiModelDescription>"""


@pytest.fixture
def gear(tmp_path: Path) -> Description:
    file = tmp_path / "Gear.fmu"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", XML)
    return describe(file)


@pytest.mark.parametrize(("value", "number"), [("reverse", -1), ("drive", 4), (4, 4), (0, 0)])
def test_an_item_is_taken_by_its_name_or_its_value(
    gear: Description, value: object, number: int
) -> None:
    (start,) = resolve_start(gear, {"gear": value}, "gearbox")
    assert start.value == number
    assert isinstance(start.value, int)


@pytest.mark.parametrize("value", ["park", "", 1, 5, -2, 4.0, 0.5, True])
def test_what_is_no_item_is_refused_with_those_there_are(gear: Description, value: object) -> None:
    with pytest.raises(
        InvalidInput, match=r"valid: 'reverse' \(-1\), 'neutral' \(0\), 'drive' \(4\)|an integer"
    ):
        resolve_start(gear, {"gear": value}, "gearbox")
