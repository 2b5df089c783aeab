"""Units as products of SI base units."""

import pytest

from congelation.errors import InvalidInput
from congelation.fmi.units import base_unit


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
