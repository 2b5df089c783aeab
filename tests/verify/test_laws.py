"""The laws beyond the paper as built FMUs: their loops agree with the monolithic solution."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
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
    "Structured": {},
    "TrackingRadius": {"yr[0]": 1.0},
    "TrackingBound": {"yr[0]": 1.0},
    "TrackingStructured": {"yr[0]": 1.0},
    "ActiveSuspension": {},
    "WingRock": {},
    "PendulumLength": {},
    "DCMotor": {},
    "F16Pitch": {},
    # About the origin: the radius is that of theta about 0, and leakage pulls towards it.
    "Matched": {"delta": 4.0, "sigma": 0.1},
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


def test_the_pitch_of_a_transport_aircraft_agrees_with_the_monolithic_solution() -> None:
    """Third order, a stable zero, units."""
    links = cg.Connection("plant.y", "law.y"), cg.Connection("law.u", "plant.u")
    components = (
        cg.Component("plant", FMUS / "StableZero3Plant.fmu"),
        cg.Component("law", FMUS / "StableZero3Controller.fmu"),
    )
    assert deviation(cg.System(components, links), 0.5) < 1e-5


OUTPUT = {
    "tracking": [('radius = "estimated"\n', ""), ("r = 5", "r = 5, delta = 1.5, delta_1 = 1")],
    "unknown radius": [("tracking = true\n", "")],
    "both": [],
}


@pytest.mark.parametrize("changes", OUTPUT.values(), ids=OUTPUT)
def test_output_feedback_beyond_the_paper_agrees(
    tmp_path: Path, changes: list[tuple[str, str]]
) -> None:
    text = (ROOT / "specs" / "tracking_output.toml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    spec = tmp_path / "spec.toml"
    spec.write_text(text)
    plant, controller = cg.build(spec, out=tmp_path)
    links = [cg.Connection("plant.y", "law.y"), cg.Connection("law.u", "plant.u")]
    components = [cg.Component("plant", plant), cg.Component("law", controller)]
    if "tracking = true" in text:
        start = {"amplitude": [1, 0.3]}
        components.append(cg.Component("reference", FMUS / "Reference.fmu", start))
        links.append(cg.Connection("reference.yr", "law.yr"))
    assert deviation(cg.System(tuple(components), tuple(links)), 0.3) < 1e-5


DISTURBED = {"Disturbed": {}, "DisturbedOutput": {"sigma": 0.05}}


def disturbed(law: str, start: dict[str, object], driven: bool = True) -> cg.System:
    """A loop whose plant is disturbed by a block in d[2] and by a constant in d[1]."""
    measured = "y" if "Output" in law else "x"
    links = [
        cg.Connection(f"plant.{measured}", f"law.{measured}"),
        cg.Connection("law.u", "plant.u"),
    ]
    components = [
        cg.Component("plant", FMUS / f"{law}Plant.fmu", {"d[1]": 0.2} if driven else {}),
        cg.Component("law", FMUS / f"{law}Controller.fmu", start),
    ]
    if driven:
        profile = {"profile[1].sine[1].amplitude": 0.7, "profile[1].square[1].amplitude": 0.5}
        components.append(cg.Component("block", FMUS / "Disturbance.fmu", profile))
        links.append(cg.Connection("block.d[1]", "plant.d[2]"))
    return cg.System(tuple(components), tuple(links))


@pytest.mark.parametrize(("law", "start"), DISTURBED.items(), ids=DISTURBED)
def test_a_disturbed_loop_as_fmus_agrees_with_the_monolithic_solution(
    law: str, start: dict
) -> None:
    assert deviation(disturbed(law, start), 0.5) < 1e-5


def test_what_disturbs_makes_a_difference_and_nothing_is_no_disturbance() -> None:
    runs = [
        cg.simulate(disturbed("Disturbed", {}, driven), stop_time=0.3, tolerance=1e-6)
        for driven in (True, False)
    ]
    ends = [run.values[-1, run.names.index("plant.x[1]")] for run in runs]
    assert abs(ends[0] - ends[1]) > 1e-3


def test_a_law_is_certified_for_the_disturbances_that_it_is_made_for(tmp_path: Path) -> None:
    """The law without damping against d: for none, and not where a block drives d."""
    text = (ROOT / "scenarios" / "disturbed.toml").read_text()
    text = text[: text.index("[[variants]]")].replace(
        "DisturbedController", "StateFeedbackController"
    )
    file = tmp_path / "scenario.toml"
    for link, verdict in ((', "disturbance.d -> plant.d"', Verdict.VIOLATED), ("", Verdict.HOLDS)):
        changed = text.replace(', "disturbance.d -> plant.d"', link)
        if not link:
            start = changed.index("[components.disturbance]")
            changed = changed[:start] + changed[changed.index("[experiment]") :]
        file.write_text(changed)
        (found,) = certify(file, samples=60)
        assert found.verdict is verdict


def test_the_run_of_a_disturbed_loop_keeps_to_its_bound(tmp_path: Path) -> None:
    """V' at every point, the mean of the error, and the ultimate bound."""
    text = (ROOT / "scenarios" / "disturbed.toml").read_text()
    file = tmp_path / "scenario.toml"
    text = text.replace("stop_time = 40.0", "stop_time = 0.2").replace(
        "after = 20.0", "after = 0.1"
    )
    file.write_text(text)
    for run in cg.run(file, out=tmp_path / "out").runs:
        holds = run.variant != "Controller 2"
        assert (run.metrics["margin"] < 1e-9) is holds
        if holds:
            assert run.metrics["share"] < 1.0
        if run.variant.endswith("leakage"):
            assert run.metrics["ultimate_share"] <= 1.0 + 1e-9


@pytest.mark.parametrize("name", ["bound_estimator", "filtered_transformation"])
def test_rivals_as_fmus(tmp_path: Path, name: str) -> None:
    plant, controller = cg.build(ROOT / "specs" / f"{name}.toml", out=tmp_path)
    measured = "x" if name == "bound_estimator" else "y"
    links = cg.Connection(f"plant.{measured}", f"law.{measured}"), cg.Connection("law.u", "plant.u")
    components = cg.Component("plant", plant), cg.Component("law", controller)
    assert deviation(cg.System(components, links), 0.5) < 1e-5


def test_the_filtered_transformation_has_no_certificate() -> None:
    (found,) = certify(ROOT / "specs" / "filtered_transformation.toml")
    assert found.verdict is Verdict.NOT_CLAIMED
    assert "not known" in found.reasons[0]


def tracking(folder: Path, *changes: tuple[str, str]) -> Path:
    """The scenario over 1 s."""
    text = (ROOT / "scenarios" / "tracking.toml").read_text()
    for old, new in (("stop_time = 20.0", "stop_time = 1.0"), *changes):
        assert old in text
        text = text.replace(old, new)
    file = folder / "scenario.toml"
    file.write_text(text)
    return file


@pytest.mark.slow
def test_tracking_keeps_to_its_bound_along_a_run(tmp_path: Path) -> None:
    """V' at every point, and the mean of the error; with a reference that jumps, too."""
    results = cg.run(tracking(tmp_path), out=tmp_path / "out", verify=True)
    for run in results.runs:
        assert max(run.deviations.values()) < 2e-5
        if run.variant == "Controller 2":  # its damping is left out
            assert run.metrics["margin"] > 1e-3
        else:
            assert run.metrics["margin"] < 1e-9
            assert run.metrics["share"] < 1.0
            trajectory = results.trajectory(run.run_id)
            assert trajectory.columns[-3:] == tuple(
                f"certificate.{v}" for v in ("V", "rate", "bound")
            )
            V, rate, bound = trajectory.values[:, -3:].T
            assert np.all(V > 0)
            assert np.all(rate <= bound + 1e-6 * np.abs(bound))


def test_a_scenario_with_a_reference_is_certified(tmp_path: Path) -> None:
    found = {c.design.name: c.verdict for c in certify(tracking(tmp_path), samples=50)}
    assert found.pop("Controller 2") is Verdict.VIOLATED
    assert set(found.values()) == {Verdict.HOLDS}


def test_a_reference_with_too_few_derivatives_is_refused(tmp_path: Path) -> None:
    spec = tmp_path / "short.toml"
    spec.write_text('form = "reference"\nstructure = {n = 1}\n[block]\nname = "Short"\n')
    cg.build(spec, out=tmp_path)
    change = ('fmu = "Reference"', f'fmu = "{tmp_path / "Short.fmu"}"')
    with pytest.raises(InvalidInput, match=r"2 outputs for 3 inputs.*n-th.*'Tracking'") as caught:
        cg.load_scenario(tracking(tmp_path, change))
    assert "\n" not in str(caught.value)


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
        r"b\(t\) is between -0.4 and 1.4, and so may be 0.*'Varying input gain'",
    ),
    "the other sign": ("sign_b = 1, rho_hat0 = 1", "sign_b = -1", r"give sign_b = 1"),
    "an estimate of the other sign": ("rho_hat0 = 1", "rho_hat0 = -1", "rho_hat0 = 0"),
    "a radius that is left out": (
        ", delta = 1.4142135623730951",
        "",
        r"delta: it is left out, and so 1, which is less than 1.4.*'The idea'",
    ),
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
        r"controller\.start\.delta is given, while radius = .estimated..*'Unknown radius'",
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
    "a law of another form": (
        'gain = "varying"',
        'law = "filtered-transformation"',
        "law = 'filtered-transformation' is none of form 'strict-feedback'",
    ),
    "options that exclude each other": (
        'gain = "varying"',
        'gain = "varying"\nlaw = "bound-estimator"',
        "excludes gain = 'varying'",
    ),
    "structured variations of fewer parameters": (
        'gain = "varying"',
        'Upsilon = {1 = ["1", "sin(t)"]}',
        r"structure\.Upsilon\.2 is missing",
    ),
    "structured variations of rows that differ": (
        'gain = "varying"',
        'Upsilon = {1 = ["1", "sin(t)"], 2 = ["1"]}',
        r"structure\.Upsilon\.2 .*as many in each row",
    ),
    "structured variations that are not smooth": (
        'gain = "varying"',
        'Upsilon = {1 = ["sgn(t)"], 2 = ["1"]}',
        "holds sgn, which is not smooth.*'Structured variations'",
    ),
    "a gain of another kind": ('gain = "varying"', 'gain = "fast"', "gain"),
}


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES.values(), ids=MISTAKES)
def test_one_line_says_what_is_wrong(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InvalidInput, match=message) as caught:
        read_spec(changed(tmp_path, old, new))
    assert "\n" not in str(caught.value)


STRUCTURED = (ROOT / "specs" / "structured.toml").read_text()


def test_what_a_structure_leaves_has_to_be_within_the_radius(tmp_path: Path) -> None:
    """The rest of theta(t), not its box: 0.4 of the square wave and 0.4 of the fast sine."""
    (found,) = certify(changed(tmp_path, "delta = 0.57", "delta = 0.57", STRUCTURED), samples=20)
    assert found.verdict is Verdict.HOLDS
    assert found.design.radius == pytest.approx(0.4 * np.sqrt(2), rel=1e-3)
    (found,) = certify(changed(tmp_path, "delta = 0.57", "delta = 0.5", STRUCTURED), samples=20)
    assert found.verdict is Verdict.ASSUMPTION_BROKEN
    assert "theta_u(t) = theta(t) - Upsilon(t) vartheta" in found.reasons[0]


def test_a_structure_that_explains_everything_needs_no_damping(tmp_path: Path) -> None:
    """Sines alone, all of them known: the classical law, delta = 0."""
    text = STRUCTURED.replace("    {square = {amplitude = 0.4, period = 1.3}},\n", "")
    text = text.replace("    {sine = {amplitude = 0.4, omega = 20}},\n", "")
    file = changed(tmp_path, "delta = 0.57", "delta = 0, damping = false", text)
    (found,) = certify(file, samples=100, umax=100.0)
    assert found.verdict is Verdict.HOLDS
    assert found.design.radius == 0.0
    assert "V does not bound Upsilon(t)" in found.unlevelled


def test_the_set_of_a_law_has_to_hold_the_constants(tmp_path: Path) -> None:
    """vartheta = (-3, 0.6, 2, 0.6) and not the centre of theta(t)."""
    sets = "delta = 0.57, projection_ball = true, theta_center = [-3, 0, 2, 0], theta_bound = "
    for bound, verdict in (("1", Verdict.HOLDS), ("0.5", Verdict.ASSUMPTION_BROKEN)):
        file = changed(tmp_path, "delta = 0.57", sets + bound, STRUCTURED)
        (found,) = certify(file, samples=20)
        assert found.verdict is verdict


@pytest.mark.slow
def test_structured_variations_keep_to_their_claim_along_a_run(tmp_path: Path) -> None:
    text = (ROOT / "scenarios" / "structured.toml").read_text()
    assert "stop_time = 20.0" in text
    file = tmp_path / "scenario.toml"
    file.write_text(text.replace("stop_time = 20.0", "stop_time = 3.0"))
    damped, free = cg.run(file, out=tmp_path / "out").runs
    assert damped.metrics["margin"] < 1e-9
    assert free.metrics["margin"] > 1e-3
    with pytest.raises(InvalidInput, match="which an attack would break"):
        cg.attack(file, effort=0.01)


def test_the_ultimate_bound_under_leakage(tmp_path: Path) -> None:
    """a = min(2 c, sigma lambda_min(Gamma)) and b = sigma |ell - theta_c|^2/2, ell = (-3, 2)."""
    text = (ROOT / "specs" / "state_feedback.toml").read_text()
    old = "start = {c = [0.5, 0.5]"
    (found,) = certify(changed(tmp_path, old, old + ", sigma = 0.1", text), samples=50)
    assert found.ultimate == pytest.approx(0.1 * 13 / 2 / 0.1)
    (found,) = certify(ROOT / "specs" / "state_feedback.toml", samples=50)
    assert found.ultimate is None
    (found,) = certify(ROOT / "specs" / "tracking.toml", samples=50)  # depends on the reference
    assert found.ultimate is None


def test_a_run_keeps_below_its_ultimate_bound(tmp_path: Path) -> None:
    change = (
        'share = {metric = "lyapunov_share"}',
        'bound = {metric = "ultimate_bound"}\nused = {metric = "ultimate_share"}',
    )
    text = tracking(tmp_path, change).read_text()
    file = tmp_path / "leakage.toml"
    file.write_text(text)
    scenario = cg.load_scenario(file)
    runs = {run.variant: run for run in cg.run(scenario, out=tmp_path / "out").runs}
    leaking = runs["with leakage"].metrics
    # a = sigma Gamma = 1; at least the residue of leakage, sigma |ell - theta_c|^2/2 = 0.025 * 13
    assert leaking["bound"] > 0.32
    assert 0 < leaking["used"] <= 1
    assert runs["epsilon_r = 1"].metrics["bound"] is None
