"""Units as products of SI base units."""

from pathlib import Path

import pytest

from congelation.errors import InvalidInput
from congelation.fmi.description import describe
from congelation.fmi.units import base_unit, conversion
from tests.cosim.c_fmus import SOURCES, compile_fmu


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        ("1/s", {"s": "-1"}),
        ("rad/s2", {"s": "-2", "rad": "1"}),
        ("N.m/rad", {"kg": "1", "m": "2", "s": "-2", "rad": "-1"}),
        ("V.s/rad", {"kg": "1", "m": "2", "s": "-2", "A": "-1", "rad": "-1"}),
        ("m/s/s", {"m": "1", "s": "-2"}),
        ("deg", {"rad": "1", "factor": "0.017453292519943295"}),
    ],
)
def test_products(unit, expected):
    assert base_unit(unit) == expected


def test_unknown_names_are_refused():
    with pytest.raises(InvalidInput, match="'furlong' is no unit"):
        base_unit("furlong/s")


DEGENERATE = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="plain" guid="{2}">
<CoSimulation modelIdentifier="plain"/>
<UnitDefinitions>
<Unit name="K"><BaseUnit K="1"/><DisplayUnit name="shown" factor="0"/></Unit>
<Unit name="of 0"><BaseUnit K="1" factor="0"/></Unit>
<Unit name="of inf"><BaseUnit K="1" factor="INF"/></Unit>
<Unit name="from nan"><BaseUnit K="1" offset="NaN"/></Unit>
</UnitDefinitions>
<ModelVariables>
<ScalarVariable name="u1" valueReference="0"><Real nominal="INF"/></ScalarVariable>
<ScalarVariable name="u2" valueReference="1"><Real nominal="NaN"/></ScalarVariable>
</ModelVariables>
<ModelStructure/></fmiModelDescription>
"""


def test_units_and_sizes_that_are_none_convert_and_weigh_nothing(tmp_path: Path) -> None:
    """A factor of 0 or an infinite offset defines no unit, an infinite nominal value no size."""
    found = describe(compile_fmu(tmp_path / "plain.fmu", SOURCES / "plain.c", DEGENERATE))
    for name in ("of 0", "of inf", "from nan"):
        assert conversion(found.unit(name), found.unit("K")).doubt.endswith("cannot be compared")
    assert found.unit("shown").exponents is None
    assert [variable.nominal for variable in found.variables.values()] == [1.0, 1.0]


def test_a_unit_with_an_offset_stands_in_no_product():
    with pytest.raises(InvalidInput, match=r"'degC' has an offset .*; give 'K'"):
        base_unit("degC/s")


@pytest.mark.parametrize(
    ("unit", "told"),
    [
        ("Kelvin", "'Kelvin' is no unit; give 'K'"),
        ("kelvins/s", "'kelvins' is no unit; give 'K'"),
        ("Celsius", "'degC' has an offset .*; give 'K'"),
        ("°C", "'degC' has an offset .*; give 'K'"),
        ("degF", "'degF' has an offset .*; give 'K'"),
        ("Meter/sec", "'Meter' is no unit; give 'm'"),
        ("radd", "'radd' is no unit; did you mean 'rad'"),
    ],
)
def test_units_in_words_are_answered_with_their_symbol(unit, told):
    with pytest.raises(InvalidInput, match=told):
        base_unit(unit)
