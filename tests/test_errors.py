"""What messages quote: values as files spell them, numbers of things in words."""

from __future__ import annotations

import numpy as np
import pytest

from congelation.errors import amount, counted, shown


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (True, "true"),
        (2, "2"),
        (0.5, "0.5"),
        (np.float64(0.5), "0.5"),
        (float("inf"), "inf"),
        ("fast", "'fast'"),
        ([1, False, "a"], "[1, false, 'a']"),
        ((1.0, 2.0), "[1.0, 2.0]"),
        (np.array([[0.0], [0.5]]), "[0.0, 0.5]"),
        (np.array([[1.0, 2.0], [3.0, 4.0]]), "[[1.0, 2.0], [3.0, 4.0]]"),
        (np.array([[0.0]]), "0.0"),
        ({"value": 1, "unit": "kg"}, "{value = 1, unit = 'kg'}"),
    ],
    ids=repr,
)
def test_values_are_spelled_as_in_a_file(value: object, expected: str) -> None:
    assert shown(value) == expected


@pytest.mark.parametrize(
    "value",
    ["a" * 99, list(range(10**6)), {str(k): k for k in range(999)}],
    ids=["text", "list", "table"],
)
def test_long_values_are_cut(value: object) -> None:
    assert len(shown(value)) <= 60
    assert "..." in shown(value)


def test_values_that_python_cannot_print_are_described() -> None:
    nested: list[object] = []
    for _ in range(10**4):
        nested = [nested]
    assert shown(nested) == "[[[[[[...]]]]]]"
    assert shown(10**5000) == "a number of 16610 bits"


def test_counts_and_shapes_agree_with_their_nouns() -> None:
    assert [counted(n, "run") for n in (0, 1, 2)] == ["0 runs", "1 run", "2 runs"]
    assert counted(2, "axis", "axes") == "2 axes"
    assert amount((1,)) == "1 number"
    assert amount((2,), "value") == "2 values"
    assert amount((1, 2)) == "1 row of 2 numbers"
    assert amount((2, 3)) == "2 rows of 3 numbers"
