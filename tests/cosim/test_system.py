"""Describing a system: every mistake is found from the XML, and said in one line."""

import dataclasses

import numpy as np
import pytest

from congelation.cosim import Component, Connection, System
from congelation.errors import InvalidInput


def start_of(fmus, values):
    system = System((Component("plant", fmus / "TestPlant.fmu", values),))
    return {s.variable.name: s.value for s in system.resolve().members[0].start}


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"w": 2}, {"w": 2.0}),
        ({"x0": [2, -1]}, {"x0[1]": 2.0, "x0[2]": -1.0}),
        ({"x0": np.array([2.0, -1.0])}, {"x0[1]": 2.0, "x0[2]": -1.0}),
        ({"x0[2]": np.float32(0.5)}, {"x0[2]": 0.5}),
        ({"w": [3.0]}, {"w": 3.0}),
        ({"u": 1.5}, {"u": 1.5}),
    ],
)
def test_start_values_are_expanded(fmus, values, expected):
    assert start_of(fmus, values) == expected


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"x00": [1, 2]}, "no vector 'x00'; did you mean 'x0'"),
        ({"ww": 1.0}, "no variable 'ww'; did you mean 'w'"),
        ({"x0": [1.0, 2.0, 3.0]}, "3 values given, 2 values needed"),
        ({"x0": [[1.0, 2.0]]}, "1 row of 2 values given, 2 values needed"),
        ({"x0": [[1.0], [2.0, 3.0]]}, "rows of different lengths"),
        ({"x0": 1.0}, "1.0 given, a list of 2 values needed"),
        ({"x0": [1.0, 2.0], "x0[1]": 3.0}, "'x0[1]' is given by 'x0' as well"),
        ({"x0[1]": 3.0, "x0": [1.0, 2.0]}, "'x0': 'x0[1]' is given by 'x0[1]' as well; leave one"),
        ({"w": "fast"}, "'fast' given, a number needed"),
        ({"w": True}, "true given, a number needed"),
        ({"w": float("nan")}, "nan is no value"),
        ({"x[1]": 1.0}, "of causality output; only parameters"),
    ],
)
def test_wrong_start_values_are_named(fmus, values, message):
    with pytest.raises(InvalidInput, match="component 'plant', start value") as caught:
        start_of(fmus, values)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"n_in": 2**31}, "does not fit in 32 bits"),
        ({"n_in": 1.5}, "1.5 given, an integer needed"),
        ({"b_in": "yes"}, "'yes' given, true or false needed"),
        ({"s_in": 3}, "3 given, a string needed"),
    ],
)
def test_types_of_start_values_are_checked(fmus, values, message):
    system = System((Component("d", fmus / "TestDiscrete.fmu", values),))
    with pytest.raises(InvalidInput, match="start value") as caught:
        system.resolve()
    assert message in str(caught.value)


def test_vectors_are_connected_element_by_element(loop):
    resolved = loop().resolve()
    assert [link.name for link in resolved.links] == [
        "plant.x[1] -> controller.x[1]",
        "plant.x[2] -> controller.x[2]",
        "controller.u -> plant.u",
    ]


def test_derivatives_are_connected_along_with_values(loop):
    link = loop().resolve().links[0]
    assert [v and v.name for v in link.source_derivatives] == ["der(x[1])", None, None]
    assert [v.name for v in link.target_derivatives] == [
        "der(x[1])",
        "der(x[1],2)",
        "der(x[1],3)",
    ]


def test_a_written_out_derivative_connection_changes_nothing(loop):
    system = loop()
    written = dataclasses.replace(
        system,
        connections=(*system.connections, Connection("plant.der(x[1])", "controller.der(x[1])")),
    )
    assert written.resolve().links == system.resolve().links


@pytest.mark.parametrize(
    ("connection", "message"),
    [
        ("plant.y -> controller.x", "no variable 'y'"),
        ("plant.x[3] -> controller.x[1]", "no variable 'x[3]'; did you mean 'x[2]'"),
        ("plnt.x -> controller.x", "no component 'plnt'; did you mean 'plant'"),
        ("plant.x -> controller.q", "2 outputs for 1 input;"),
        ("plant.w -> controller.x[1]", "of causality parameter; the source must be an output"),
        ("plant.x[1] -> controller.u", "of causality output; the target must be an input"),
        ("plant -> controller.x", "write it as 'component.variable'"),
        ("controller.u -> plant.u", "driven already by 'controller.u -> plant.u'"),
        ("controller.q -> plant.der(u)", "the coupling drives this input"),
    ],
)
def test_wrong_connections_are_named(loop, connection, message):
    system = loop()
    wrong = dataclasses.replace(
        system, connections=(*system.connections, Connection.parse(connection))
    )
    with pytest.raises(InvalidInput, match="connection") as caught:
        wrong.resolve()
    assert message in str(caught.value)


def test_types_of_connections_must_agree(fmus):
    system = System(
        (Component("d", fmus / "TestDiscrete.fmu"), Component("g", fmus / "TestGain.fmu")),
        (Connection("d.n_out", "g.u"),),
    )
    with pytest.raises(InvalidInput, match="'n_out' is Integer and 'u' is Real"):
        system.resolve()


@pytest.mark.parametrize("text", ["plant.x", "a -> b -> c", "-> b", ""])
def test_a_connection_needs_two_ends(text):
    with pytest.raises(InvalidInput, match="write it as"):
        Connection.parse(text)


def test_a_missing_fmu_names_the_build_command(tmp_path):
    system = System((Component("plant", tmp_path / "Nothing.fmu"),))
    with pytest.raises(InvalidInput, match=r"component 'plant': .*congelation build"):
        system.resolve()


def test_a_file_that_is_no_fmu_is_refused(tmp_path):
    file = tmp_path / "Broken.fmu"
    file.write_text("not a zip file")
    with pytest.raises(InvalidInput, match="is not an FMU"):
        System((Component("plant", file),)).resolve()


@pytest.mark.parametrize("names", [("a", "a"), ("a.b", "c"), ("", "c"), ("a b", "c")])
def test_component_names_are_checked(loop, names):
    with pytest.raises(InvalidInput, match="component"):
        loop(names=names).resolve()


def test_recording_everything_leaves_out_strings_derivatives_and_events(loop, fmus):
    names = [item.name for item in loop().resolve().recorded(None)]
    assert names == ["plant.x[1]", "plant.x[2]", "controller.u", "controller.q"]
    discrete = System((Component("d", fmus / "TestDiscrete.fmu"),)).resolve()
    assert [item.name for item in discrete.recorded(None)] == ["d.n_out", "d.b_out", "d.y"]


def test_recorded_names_are_checked(loop, fmus):
    with pytest.raises(InvalidInput, match=r"record 'plant\.z'"):
        loop().resolve().recorded(["plant.z"])
    discrete = System((Component("d", fmus / "TestDiscrete.fmu"),)).resolve()
    with pytest.raises(InvalidInput, match="a String cannot be recorded"):
        discrete.recorded(["d.s_out"])
