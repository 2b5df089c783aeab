"""An FMU in C that moves derivatives by FMI functions instead of der(.) variables."""

import subprocess
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from congelation.cosim import Component, Connection, Status, System, simulate
from congelation.errors import InvalidInput, SlaveError
from congelation.fmi.description import describe
from congelation.fmi.slave import Slave

from .monolithic import order

SOURCE = Path(__file__).parent / "fmus" / "interpolating.c"

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Interpolating" guid="{{1}}">
  <CoSimulation modelIdentifier="Interpolating" canHandleVariableCommunicationStepSize="{varies}"
    canInterpolateInputs="{interpolates}" maxOutputDerivativeOrder="1"
    canGetAndSetFMUstate="true"/>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="y" valueReference="1" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="f" valueReference="2" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="wrong" valueReference="9" causality="local"><Real/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="2" dependencies=""/><Unknown index="3" dependencies="1"/></Outputs>
  </ModelStructure>
</fmiModelDescription>
"""


def build(folder, interpolates, varies="true"):
    """Compile the FMU; it says that it interpolates inputs and varies steps, or not."""
    library = folder / "Interpolating.so"
    headers = Path(fmpy.__file__).parent / "c-code"
    subprocess.run(
        ["gcc", "-shared", "-fPIC", "-O2", f"-I{headers}", SOURCE, "-lm", "-o", library],
        check=True,
    )
    path = folder / f"Interpolating_{interpolates}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(library, f"binaries/{fmpy.platform}/Interpolating.so")
        archive.writestr(
            "modelDescription.xml", DESCRIPTION.format(interpolates=interpolates, varies=varies)
        )
    return path


@pytest.fixture(scope="module")
def able(tmp_path_factory):
    return build(tmp_path_factory.mktemp("c"), "true")


@pytest.fixture(scope="module")
def unable(tmp_path_factory):
    return build(tmp_path_factory.mktemp("c"), "false")


def ring(first, second):
    """Two oscillators, each driven by the position of the other."""
    return System(
        (Component("a", first), Component("b", second)),
        (Connection("a.y", "b.u"), Connection("b.y", "a.u")),
    )


def exact(times):
    def rates(t, z):
        return [z[1], -4.0 * z[0] + z[2], z[3], -4.0 * z[2] + z[0]]

    solution = solve_ivp(
        rates,
        (0.0, times[-1]),
        [1.0, 0.0, 1.0, 0.0],
        method="DOP853",
        rtol=1e-12,
        atol=1e-13,
        t_eval=times,
    )
    return solution.y[[0, 2]].T


def errors(system, coupling, steps, **kwargs):
    found = []
    for step in steps:
        result = simulate(
            system, stop_time=2.0, step=step, coupling=coupling, record=["a.y", "b.y"], **kwargs
        )
        assert result.completed, result.message
        found.append(np.abs(result.values - exact(result.time)).max())
    return found


@pytest.mark.parametrize(
    ("coupling", "steps", "expected"),
    [("derivative", (0.1, 0.05, 0.025), 2.0), ("hermite", (0.2, 0.1, 0.05), 4.0)],
)
def test_derivatives_move_by_fmi_functions(able, coupling, steps, expected):
    system = ring(able, able)
    assert order(steps, errors(system, coupling, steps)) == pytest.approx(expected, abs=0.3)


def test_held_couplings_send_no_derivatives(able, unable):
    kwargs = {"stop_time": 1.0, "step": 0.1, "coupling": "gauss_seidel"}
    one, two = (simulate(ring(fmu, fmu), **kwargs) for fmu in (able, unable))
    assert np.array_equal(one.values, two.values)


def test_a_mixed_ring_is_of_order_two_where_an_input_can_only_be_held(able, unable):
    """The held input is the mean of its cubic over the step."""
    steps = (0.1, 0.05, 0.025)
    found = errors(ring(able, unable), "hermite", steps)
    assert order(steps, found) == pytest.approx(2.0, abs=0.3)


def test_order_six_names_the_connection_that_cannot(able, unable):
    system = ring(able, unable)
    with pytest.raises(InvalidInput, match=r"order 6 needs .* a\.y -> b\.u"):
        simulate(system, stop_time=1.0, step=0.1, coupling="hermite", options={"order": 6})
    (error,) = errors(ring(able, able), "hermite", (0.05,), options={"order": 6})
    assert error < errors(ring(able, able), "hermite", (0.05,))[0]


def test_a_ring_of_two_kinds_follows_a_tolerance(able, fmus):
    """A C FMU with FMI functions, and a Python one with der(.) variables, in one loop."""
    system = System(
        (Component("a", able), Component("g", fmus / "TestGain.fmu", {"k": -0.5})),
        (Connection("a.y", "g.u"), Connection("g.y", "a.u")),
    )
    result = simulate(system, stop_time=3.0, tolerance=1e-6, coupling="hermite", record=["a.y"])
    expected = np.cos(np.sqrt(4.5) * result.time)
    assert np.abs(result.values[:, 0] - expected).max() < 1e-6


def test_feedthrough_of_a_held_input_is_evaluated_at_the_end_of_the_step(unable, fmus):
    """f = u at once: after a step it must be the newest u, not the mean over the step."""
    system = System(
        (Component("p", fmus / "TestPlant.fmu"), Component("a", unable)),
        (Connection("p.x[1]", "a.u"),),
    )
    result = simulate(system, stop_time=1.0, step=0.1, coupling="hermite", record=["p.x[1]", "a.f"])
    assert np.array_equal(result.values[:, 0], result.values[:, 1])


def test_a_message_is_formatted_with_its_arguments(able):
    with Slave("s", describe(able)) as slave, pytest.raises(SlaveError) as caught:
        slave.get_values("Real", [9])
    assert caught.value.message == "reference 9 of 100% is unknown"


def test_a_failing_read_ends_the_run(able):
    system = System((Component("a", able),))
    result = simulate(system, stop_time=1.0, step=0.1, record=["a.wrong"])
    assert result.status is Status.SLAVE_FAILED
    assert "reference 9" in result.message


def test_an_fmu_with_a_fixed_step_is_given_one(tmp_path):
    system = System((Component("a", build(tmp_path, "true", varies="false")),))
    assert simulate(system, stop_time=1.0, step=0.1).completed
    for kwargs in ({"step": 0.3}, {"tolerance": 1e-3, "coupling": "hermite"}):
        with pytest.raises(InvalidInput, match=r"component 'a'.*one length only"):
            simulate(system, stop_time=1.0, **kwargs)
