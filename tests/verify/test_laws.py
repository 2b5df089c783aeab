"""The laws beyond the paper as built FMUs: their loops agree with the monolithic solution."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import congelation as cg
from congelation.errors import InvalidInput
from congelation.export.spec import read_spec
from congelation.verify.certify import Verdict, certify
from tests.scenarios import FMUS, ROOT

LAWS = {
    "Tracking": {"yr[0]": 1.0},
    "VaryingGain": {},
    "UnknownRadius": {},
    "Nonlinear": {},
}


def system(plant: str, controller: str, start: dict[str, object]) -> cg.System:
    links = cg.Connection("plant.x", "law.x"), cg.Connection("law.u", "plant.u")
    components = (
        cg.Component("plant", FMUS / f"{plant}.fmu"),
        cg.Component("law", FMUS / f"{controller}.fmu", start),
    )
    return cg.System(components, links)


def deviation(found: cg.System, stop: float = 1.5) -> float:
    result = cg.simulate(found, stop_time=stop, tolerance=1e-7, coupling="hermite", step=1e-3)
    assert result.status.name == "COMPLETED", result.message
    return max(entry.relative for entry in cg.verify(found, result))


@pytest.mark.parametrize(("law", "start"), LAWS.items(), ids=LAWS)
def test_a_law_as_fmus_agrees_with_the_monolithic_solution(law: str, start: dict) -> None:
    assert deviation(system(f"{law}Plant", f"{law}Controller", start)) < 1e-5


def test_a_plant_goes_with_every_law_of_its_system() -> None:
    found = system("StrictFeedbackPlant", "UnknownRadiusController", {})
    assert deviation(found, 0.3) < 1e-5


def test_a_plant_and_a_law_of_different_systems_are_told_apart() -> None:
    with pytest.raises(InvalidInput, match="different systems"):
        deviation(system("VaryingGainPlant", "UnknownRadiusController", {}), 0.01)


SPEC = (ROOT / "specs" / "varying_gain.toml").read_text()


def changed(folder: Path, old: str, new: str, text: str = SPEC) -> Path:
    assert old in text
    file = folder / "spec.toml"
    file.write_text(text.replace(old, new))
    return file


BROKEN = {
    "a gain that crosses 0": (
        "{constant = 1},",
        "{constant = 0.5},",
        r"b\(t\) is between -0.4 and 1.4, and so may be 0",
    ),
    "the other sign": ("sign_b = 1, rho_hat0 = 1", "sign_b = -1", r"give sign_b = 1"),
    "an estimate of the other sign": ("rho_hat0 = 1", "rho_hat0 = -1", "rho_hat0 = 0"),
    "a radius that is too small": ("delta = 1.4142", "delta = 1.2142", r"radius of the box"),
}


@pytest.mark.parametrize(("old", "new", "message"), BROKEN.values(), ids=BROKEN)
def test_broken_assumptions(tmp_path: Path, old: str, new: str, message: str) -> None:
    (found,) = certify(changed(tmp_path, old, new), samples=10)
    assert found.verdict is Verdict.ASSUMPTION_BROKEN
    assert any(re.search(message, reason) for reason in found.reasons)


MISTAKES = {
    "delta given and estimated": (
        'gain = "varying"',
        'gain = "varying"\nradius = "estimated"',
        r"controller\.start\.delta is given, while radius = .estimated.",
    ),
    "phi and phibar": (
        'gain = "varying"',
        'phi = {1 = ["x[1]", "0"]}',
        "phibar and phi are two ways",
    ),
    "no number of formulas": (
        'phibar = {"1,1" = [-1, 0], "2,1" = [0, -1]}',
        'phi = {1 = ["x[1]"]}',
        r"structure\.phi\.1.*2 formulas",
    ),
    "a gain of another kind": ('gain = "varying"', 'gain = "fast"', "gain"),
}


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES.values(), ids=MISTAKES)
def test_one_line_says_what_is_wrong(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InvalidInput, match=message) as caught:
        read_spec(changed(tmp_path, old, new))
    assert "\n" not in str(caught.value)
