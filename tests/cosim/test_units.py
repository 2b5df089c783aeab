"""Connections and start values mean what their units say."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave

from congelation.cosim.master import simulate
from congelation.cosim.system import Component, Connection, System
from congelation.errors import InvalidInput
from congelation.fmi.description import derivative_name, describe
from congelation.fmi.units import Unit, conversion, unit_named
from tests.scenarios import FMUS

DEFINITIONS = """
    <Unit name="K"><BaseUnit K="1"/></Unit>
    <Unit name="degC">
        <BaseUnit K="1" offset="273.15"/><DisplayUnit name="degF" factor="1.8" offset="32"/>
    </Unit>
    <Unit name="rad"><BaseUnit rad="1"/></Unit>
    <Unit name="deg"><BaseUnit rad="1" factor="0.017453292519943295"/></Unit>
    <Unit name="1"><BaseUnit/></Unit>
    <Unit name="m/s"><BaseUnit m="1" s="-1"/></Unit>
    <Unit name="km/h"><BaseUnit m="1" s="-1" factor="0.2777777777777778"/></Unit>
    <Unit name="furlong"/>
"""


def with_units(folder: Path, name: str, units: Mapping[str, str]) -> Path:
    """A copy of a built FMU whose variables state other units; an empty one states none."""
    target = folder / f"{name}.fmu"
    with zipfile.ZipFile(FMUS / f"{name}.fmu") as old, zipfile.ZipFile(target, "w") as new:
        for entry in old.namelist():
            content = old.read(entry)
            if entry == "modelDescription.xml":
                text = content.decode()
                defined = re.findall(r'<Unit name="([^"]*)"', DEFINITIONS)
                for unit in defined:  # ours replace those there
                    text = re.sub(rf'<Unit name="{unit}">.*?</Unit>', "", text, flags=re.S)
                text = text.replace("<UnitDefinitions>", f"<UnitDefinitions>{DEFINITIONS}")
                for variable, unit in units.items():
                    at = text.index(f'<ScalarVariable name="{variable}"')
                    head, tail = text[:at], text[at:]
                    begin = tail.index("<Real")
                    end = tail.index(">", begin)
                    real = re.sub(r' unit="[^"]*"', "", tail[begin:end])
                    stated = f'<Real unit="{unit}"' if unit else "<Real"
                    text = head + tail[:begin] + real.replace("<Real", stated) + tail[end:]
                content = text.encode()
            new.writestr(entry, content)
    return target


def loop(folder: Path, output: str, input_: str, x0: float = 300.0, *back: Connection) -> System:
    """The scalar plant, its output and the controller's input in these units."""

    def stated(unit: str, *orders: int) -> dict[str, str]:
        names = {derivative_name("x", order): unit and unit + order * "/s" for order in orders}
        return {"x": unit, **names}

    return System(
        (
            Component("plant", with_units(folder, "ScalarPlant", stated(output, 1)), {"x0": x0}),
            Component(
                "controller", with_units(folder, "ScalarController", stated(input_, 1, 2, 3))
            ),
        ),
        (Connection("plant.x", "controller.x"), *back),
    )


CONVERSIONS = [
    ("K", "degC", 1.0, -273.15),
    ("degC", "K", 1.0, 273.15),
    ("K", "degF", 1.8, -459.67),
    ("rad", "deg", 180.0 / np.pi, 0.0),
    ("m/s", "km/h", 3.6, 0.0),
    ("km/h", "m/s", 1.0 / 3.6, 0.0),
]


@pytest.mark.parametrize(("source", "target", "factor", "offset"), CONVERSIONS)
@pytest.mark.parametrize("coupling", ["jacobi", "gauss_seidel", "derivative", "hermite", "sampled"])
def test_values_are_converted_and_derivatives_have_no_offset(
    tmp_path: Path, coupling: str, source: str, target: str, factor: float, offset: float
) -> None:
    names = ["plant.x", "controller.x", "plant.der(x)", "controller.der(x)"]
    result = simulate(
        loop(tmp_path, source, target),
        stop_time=0.01,
        step=0.001,
        coupling=coupling,
        options={"sample_time": 0.001} if coupling == "sampled" else None,
        record=names,
    )
    assert result.completed, result.message
    x, converted, slope, converted_slope = result.values.T
    assert x[0] == 300.0
    assert converted == pytest.approx(factor * x + offset, rel=1e-12, abs=1e-9)
    if coupling in ("derivative", "hermite"):
        # The input holds the slope with which the last step began.
        assert converted_slope[-1] == pytest.approx(factor * slope[-2], rel=1e-3)
        assert abs(converted_slope[-1]) > 1.0


def test_a_converted_loop_is_that_of_an_independent_master(tmp_path: Path) -> None:
    """Jacobi by FMPy, with km/h = 3.6 m/s written out."""
    system = loop(tmp_path, "m/s", "km/h", 0.5, Connection("controller.u", "plant.u"))
    h, steps = 1e-3, 50
    slaves, references = [], []
    for component in system.components:
        model = fmpy.read_model_description(str(component.fmu), validate=False)
        slave = FMU2Slave(
            guid=model.guid,
            unzipDirectory=fmpy.extract(str(component.fmu), str(tmp_path / component.name)),
            modelIdentifier=model.coSimulation.modelIdentifier,
            instanceName=component.name,
        )
        slave.instantiate()
        slave.setupExperiment(startTime=0.0)
        slaves.append(slave)
        references.append({v.name: v.valueReference for v in model.modelVariables})
    (plant, controller), (of_plant, of_controller) = slaves, references
    plant.setReal([of_plant["x0[1]" if "x0[1]" in of_plant else "x0"]], [0.5])
    for slave in slaves:
        slave.enterInitializationMode()

    def x_and_u() -> tuple[float, float]:
        return plant.getReal([of_plant["x"]])[0], controller.getReal([of_controller["u"]])[0]

    (x, _) = x_and_u()
    controller.setReal([of_controller["x"]], [3.6 * x])  # u follows from x at once
    (x, u) = x_and_u()
    plant.setReal([of_plant["u"]], [u])
    for slave in slaves:
        slave.exitInitializationMode()
    expected = [x]
    for k in range(steps):
        for slave in slaves:
            slave.doStep(k * h, h)
        (x, u) = x_and_u()  # both as the step left them
        controller.setReal([of_controller["x"]], [3.6 * x])
        plant.setReal([of_plant["u"]], [u])
        expected.append(x)
    result = simulate(system, stop_time=steps * h, step=h, coupling="jacobi", record=["plant.x"])
    assert result.completed
    assert result.values[:, 0] == pytest.approx(np.array(expected), rel=1e-12)


def test_other_base_units_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput) as refused:
        loop(tmp_path, "K", "m/s").resolve()
    assert str(refused.value) == (
        "connection 'plant.x -> controller.x': 'K' cannot become 'm/s': K against m.s-1 in SI units"
    )


@pytest.mark.parametrize(
    ("source", "target", "doubt"),
    [
        ("K", "", "the input states no unit, the other end 'K'"),
        ("", "K", "the output states no unit, the other end 'K'"),
        ("rad", "1", "'rad' and '1' differ by radians"),
        ("furlong", "K", "'furlong' and 'K' cannot be compared"),
        ("furlong", "furlong", ""),
        ("", "1", ""),
        ("", "", ""),
        ("degC", "degC", ""),
    ],
)
def test_what_cannot_be_compared_is_doubted(
    tmp_path: Path, source: str, target: str, doubt: str
) -> None:
    system = loop(tmp_path, source, target)
    first = system.resolve().links[0]
    assert (first.doubt, first.factor, first.offset) == (doubt, 1.0, 0.0)
    # Who composes a system in Python gets no warnings of a scenario.
    message = simulate(system, stop_time=0.02, step=0.01, coupling="jacobi").message
    said = f"Connection 'plant.x -> controller.x': {doubt}."
    assert (said in message) == bool(doubt)


def test_differences_have_no_offset() -> None:
    kelvin, celsius = unit_named("K"), unit_named("degC")
    assert conversion(kelvin, celsius, relative=True).offset == 0.0
    assert conversion(kelvin, celsius).offset == pytest.approx(-273.15)


def test_display_units_are_known(tmp_path: Path) -> None:
    found = describe(with_units(tmp_path, "ScalarPlant", {"x": "K"})).units["degF"]
    assert isinstance(found, Unit)
    assert found.factor * 212.0 + found.offset == pytest.approx(373.15)
    assert unit_named("degF").factor * 212.0 + unit_named("degF").offset == pytest.approx(373.15)


@pytest.mark.parametrize(
    ("rate", "fits"), [("K/s", True), ("", True), ("degC/s", True), ("mK/s", True), ("K/h", False)]
)
def test_a_derivative_in_another_unit_is_left_out(tmp_path: Path, rate: str, fits: bool) -> None:
    """What no one defines, such as mK/s, is taken as it is."""
    system = System(
        (
            Component("plant", with_units(tmp_path, "ScalarPlant", {"x": "degC", "der(x)": rate})),
            Component("controller", with_units(tmp_path, "ScalarController", {"x": "degC"})),
        ),
        (Connection("plant.x", "controller.x"),),
    )
    resolved = system.resolve()
    (link,) = resolved.links
    assert (link.source_derivatives[0] is not None) is resolved.knows_derivative(link) is fits
    if not fits:
        assert link.doubt.startswith("'der(x)' is in 'K/h', which is not the unit of 'x' ('degC')")
    record = ["plant.der(x)", "plant.x"]
    result = simulate(system, stop_time=0.1, step=0.01, coupling="jacobi", record=record)
    assert result.completed, result.message
