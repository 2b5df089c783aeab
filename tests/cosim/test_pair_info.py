"""`info`: what an FMU is, and the longest steps of a pair with held inputs, against known cases."""

from __future__ import annotations

import math
import re
import sys
import zipfile
from pathlib import Path

import pytest

from congelation.cosim import Component, Connection, System, simulate
from congelation.cosim.pair_info import Trial, _accurate, _connected, info
from congelation.errors import InvalidInput
from congelation.fmi.info import fmu_info
from tests.scenarios import FMUS

PLANT, CONTROLLER = FMUS / "ScalarPlant.fmu", FMUS / "ScalarController.fmu"


def test_one_fmu() -> None:
    (found,) = info(CONTROLLER).fmus
    assert [v.name for v in found.connect] == ["x"]
    assert [v.name for v in found.leave] == ["der(x)", "der(x,2)", "der(x,3)"]
    epsilon = next(v for v in found.parameters if v.name == "epsilon")
    assert (epsilon.type, float(epsilon.start or "nan")) == ("Real", 1.0)
    assert found.saves_state
    assert found.stop_time == 10.0
    text = str(found)
    for part in ("ScalarController.fmu: ", "inputs to connect", "leave alone", "epsilon"):
        assert part in text
    assert "its host needs a Python 3.9 or newer; `congelation build SPEC --native`" in text
    assert "needs a Python" not in str(info(FMUS / "native" / "ScalarController.fmu"))


def test_the_disturbance_of_a_plant_is_left_alone() -> None:
    (found,) = info(PLANT).fmus
    assert [v.name for v in found.connect] == ["u"]
    assert "dtheta[1]" in [v.name for v in found.leave]
    # Dozens of parameters of the profile are one line.
    assert str(found).count("profile[1]") == 1


def test_elements_of_a_vector_in_different_units_are_each_shown() -> None:
    text = str(info(FMUS / "F16PitchController.fmu"))
    lines = {line.split("  ")[0]: line for line in map(str.strip, text.splitlines())}
    assert "1/s, 1/s2, 1/s  Start value of theta_hat" in lines["theta_hat0[1] .. [3]"]
    assert not lines["theta_hat0[1] .. [3]"].endswith("]")
    assert " rad, rad/s " in lines["z[1] .. [2]"]


def test_a_pair() -> None:
    """The steps that are named do what they are said to, and somewhat longer ones do not."""
    found = info(PLANT, CONTROLLER, stop_time=2.0).pair
    assert found is not None
    assert found.stable_step is not None
    assert found.accurate_step is not None
    assert set(found.connections) == {
        "ScalarPlant.x -> ScalarController.x",
        "ScalarController.u -> ScalarPlant.u",
    }
    assert 0.8 < error(found.accurate_step) / 0.01 < 1.2
    assert error(found.stable_step) <= 1.0
    longest = found.trials[0]
    if longest.error > 1.0:
        assert error(1.1 * found.stable_step) > 1.0
    else:
        assert found.stable_step == longest.step


def foreign(file: Path, folder: Path, pattern: str, by: str) -> Path:
    """The FMU as if another tool had written it, something in its description replaced."""
    path = folder / f"Other{file.name}"
    with zipfile.ZipFile(file) as read, zipfile.ZipFile(path, "w") as written:
        for entry in set(read.namelist()) - {"resources/spec.json"}:
            content = read.read(entry)
            if entry == "modelDescription.xml":
                text, count = re.subn(pattern, by, content.decode())
                assert count
                content = text.encode()
            written.writestr(entry, content)
    return path


def test_a_pair_that_is_no_loop_has_no_steps(tmp_path: Path) -> None:
    """The controller reads x; the plant gives w."""
    other = foreign(PLANT, tmp_path, 'name="x"', 'name="w"')
    found = info(other, CONTROLLER).pair
    assert found is not None
    assert found.trials == ()
    assert "nothing drives ScalarController, so this is no closed loop" in found.how
    assert "OtherScalarPlant.fmu has the outputs w, theta[1]." in found.how
    assert found.warnings == (
        "no output of OtherScalarPlant.fmu has the name of ScalarController.x",
    )


@pytest.mark.parametrize(
    ("plant", "controller", "what"),
    [
        (
            "ScalarPlant",
            "MatchedController",
            "the plant is of the form 'scalar', the controller of 'matched'; ScalarPlant.fmu gives "
            "x, and MatchedController.fmu takes x[1], x[2]; ScalarPlant.fmu was built with "
            "ScalarController.fmu; MatchedController.fmu was built with MatchedPlant.fmu",
        ),
        (
            "ScalarPlant",
            "StableZero3Controller",
            "the controller of 'observer'; no output of ScalarPlant.fmu has the name of "
            "StableZero3Controller.y; ",
        ),
        (
            "DCMotorPlant",
            "F16PitchController",
            "'DCMotorPlant.x[1] -> F16PitchController.x[1]': 'rad/s' cannot become 'rad': s-1.rad "
            "against rad in SI units; connection 'DCMotorPlant.x[2] -> F16PitchController.x[2]': ",
        ),
        (
            "StableZero3Plant",
            "StateFeedbackController",
            "the plant is of order 3, the controller of order 2; StableZero3Plant.fmu gives x[1], "
            "x[2], x[3], and StateFeedbackController.fmu takes x[1], x[2]; ",
        ),
    ],
)
def test_all_that_does_not_fit_is_named_and_what_would(
    plant: str, controller: str, what: str
) -> None:
    with pytest.raises(InvalidInput, match=f"{plant}.fmu and {controller}.fmu do not fit: ") as no:
        info(FMUS / f"{plant}.fmu", FMUS / f"{controller}.fmu")
    assert what in str(no.value)


def test_what_may_not_fit_is_a_warning(tmp_path: Path) -> None:
    files = FMUS / "StrictFeedbackPlant.fmu", FMUS / "StructuredController.fmu"
    found = info(*files, stop_time=0.1)
    assert found.pair is not None
    warning = "they were built from different specs, 'System (60), state feedback' and 'System (60)"
    assert found.pair.warnings[0].startswith(warning)
    assert f"warning: {warning}" in str(found)
    # Units on one side alone; without a spec the plant may be any.
    bare = foreign(FMUS / "F16PitchPlant.fmu", tmp_path, ' unit="rad[^"]*"', "")
    _, doubts = _connected(fmu_info(bare), fmu_info(FMUS / "F16PitchController.fmu"))
    assert doubts == tuple(
        f"connection '{link}': the {end} states no unit, the other end '{unit}'"
        for link, end, unit in (
            ("OtherF16PitchPlant.x[1] -> F16PitchController.x[1]", "output", "rad"),
            ("OtherF16PitchPlant.x[2] -> F16PitchController.x[2]", "output", "rad/s"),
            ("F16PitchController.u -> OtherF16PitchPlant.u", "input", "rad/s2"),
        )
    )


def test_the_two_of_one_spec_fit() -> None:
    for file in FMUS.glob("*Plant.fmu"):
        plant = fmu_info(file)
        assert plant.design is not None
        _, doubts = _connected(plant, fmu_info(FMUS / f"{plant.design.controller}.fmu"))
        assert all("Controller.yr[0], yr[1], yr[2]" in doubt for doubt in doubts)


def test_it_is_said_why_the_runs_end_when_they_do(tmp_path: Path) -> None:
    found = info(PLANT, CONTROLLER).pair
    assert found is not None
    assert "The runs end at 10 s, the stop time that the FMUs propose; a loop that" in found.how
    files = [
        foreign(file, tmp_path, "<DefaultExperiment[^>]*>", "") for file in (PLANT, CONTROLLER)
    ]
    found = info(*files).pair
    assert found is not None
    assert "The runs end at 10 s, as the FMUs propose none;" in found.how


def test_a_loop_that_needs_shorter_steps_than_its_whole_time_allows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The search goes on over shorter times, and says so."""
    monkeypatch.setattr(sys.modules["congelation.cosim.pair_info"], "MOST_STEPS", 20)
    found = info(PLANT, CONTROLLER, stop_time=2.0).pair
    assert found is not None
    assert found.stop_time < 2.0
    assert found.stable_step is not None
    assert found.accurate_step is not None
    assert 0.5 < error(found.accurate_step) / 0.01 < 2.0
    assert "Steps below 0.1 s were tried over ever shorter times, the last to" in found.how


def error(step: float) -> float:
    """Of the loop with held inputs, relative to the peaks, by a solution with tiny steps."""
    links = (Connection("p.x", "c.x"), Connection("c.u", "p.u"))
    system = System((Component("p", PLANT), Component("c", CONTROLLER)), links)
    record = ["p.x", "c.u"]
    held = simulate(system, stop_time=2.0, step=step, coupling="jacobi", record=record)
    exact = simulate(system, stop_time=2.0, step=step / 20, coupling="derivative", record=record)
    if not held.completed:
        return math.inf
    rows = [int(abs(exact.time - t).argmin()) for t in held.time]
    distance = abs(held.values - exact.values[rows]).max(axis=0)
    return float((distance / abs(exact.values).max(axis=0)).max())


def test_the_step_for_one_percent_is_interpolated_or_extrapolated() -> None:
    """Held inputs are of order 1: error = step for these made-up trials."""
    fine = [Trial(0.04, 0.04), Trial(0.02, 0.02), Trial(0.005, 0.005)]
    assert _accurate(fine) == (pytest.approx(0.01), False)
    coarse = [Trial(0.08, 0.08), Trial(0.04, 0.04)]
    assert _accurate(coarse) == (pytest.approx(0.01), True)
    # Where the error does not follow the step yet, nothing is known.
    assert _accurate([Trial(0.08, math.inf), Trial(0.04, 0.5)]) == (None, False)
    assert _accurate([Trial(1.0, 0.001)]) == (1.0, False)


@pytest.mark.parametrize(
    ("fmus", "stop_time", "message"),
    [
        ((PLANT, PLANT), None, "nothing to connect"),
        ((PLANT, CONTROLLER), -1.0, "stop time -1 is not valid"),
        ((PLANT,), 1.0, "a stop time is of the trial runs of a pair"),
        ((), None, "0 FMUs are given"),
        ((Path("none.fmu"),), None, "no FMU at none.fmu"),
    ],
)
def test_mistakes(fmus: tuple[Path, ...], stop_time: float | None, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        info(*fmus, stop_time=stop_time)
