"""`certify` checks assumptions first, then catches what V' does not keep: every verdict."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from congelation.errors import InvalidInput
from congelation.export.spec import read_spec
from congelation.export.spec_assumptions import spec_warnings
from congelation.verify.certify import Verdict, certify_design, designs_of

ROOT = Path(__file__).resolve().parents[2]
WITHOUT = ("[block]", 'law = "filtered-transformation"')
"""What a spec has that is no design, or one without a certificate."""
SPECS = sorted(
    f for f in (ROOT / "specs").glob("*.toml") if not any(w in f.read_text() for w in WITHOUT)
)


def observer(
    n: int,
    m: int,
    profile: str,
    start: str = "delta = 0.3, delta_1 = 0.3",
) -> str:
    return f"""
form = "observer"
structure = {{n = {n}, m = {m}}}
[plant]
name = "P"
[plant.profile]
{profile}
[controller]
name = "C"
start = {{{start}}}
"""


def first_order(profile: str, start: str) -> str:
    return (
        f'form = "scalar"\n[plant]\nname = "P"\n[plant.profile]\n{profile}\n'
        f'[controller]\nname = "C"\nstart = {{{start}}}\n'
    )


def strict(profile: str, start: str) -> str:
    """The plant (60)."""
    return f"""
form = "strict-feedback"
[structure]
n = 2
p = 2
phibar = {{"1,1" = [-1, 0], "2,1" = [0, -1]}}
[plant]
name = "P"
[plant.profile]
{profile}
[controller]
name = "C"
start = {{{start}}}
"""


def certified(tmp_path: Path, text: str, samples: int = 200):
    file = tmp_path / "spec.toml"
    file.write_text(text)
    (design,) = designs_of(file)
    return certify_design(design, samples=samples)


A = '"theta[{}]" = [{{constant = {}}}, {{sine = {{amplitude = 0.3, omega = 2}}}}]'
CONSTANT = '"theta[{}]" = {}'


def profiles(b, n: int) -> str:
    """b constant, a_{n-1} swinging with amplitude 0.3, the other a constant."""
    lines = [CONSTANT.format(j, value) for j, value in enumerate(b, 1)]
    lines.append(A.format(len(b) + 1, 1.0))
    lines += [CONSTANT.format(len(b) + 1 + j, 1.0) for j in range(1, n)]
    return "\n".join(lines)


@pytest.mark.parametrize("file", SPECS, ids=lambda file: file.stem)
def test_shipped_specs_hold(file):
    (design,) = designs_of(file)
    found = certify_design(design, samples=100)
    assert found.verdict is Verdict.HOLDS, found.reasons
    assert found.reasons == found.warnings == ()
    assert design.remarks == ()
    assert found.finding.resolved > 50


def test_designs_are_made_of_files_specs_and_scenarios():
    file = ROOT / "specs" / "scalar.toml"
    titles = [designs_of(source)[0].name for source in (file, str(file), read_spec(file))]
    assert titles == ["Scalar example"] * 3


def test_controller_2_is_caught():
    """Without damping nothing is promised for a theta that varies: the search finds where."""
    one, two = designs_of(ROOT / "scenarios" / "fig2.toml")
    assert certify_design(one, samples=200).holds
    found = certify_design(two, samples=200)
    assert found.verdict is Verdict.VIOLATED
    assert found.finding.margin.value > 0.0
    assert found.reasons[0].startswith("V' + promised rate = ")


def test_controller_2_of_first_order_holds_with_ell_at_the_end_of_the_interval():
    """V' = -k_bar x^2 - (theta - ell) x^2 with ell = inf theta(t)."""
    for design in designs_of(ROOT / "scenarios" / "scalar.toml"):
        assert certify_design(design, samples=200).verdict is Verdict.HOLDS


UNDAMPED = {
    "strict feedback": """
form = "strict-feedback"
structure = {n = 1, p = 2, phibar = {"1,1" = [3, -4]}}
[plant]
name = "P"
profile = {"theta[1]" = [{sine = {amplitude = 0.6, omega = 1}}], "theta[2]" = 2}
[controller]
name = "C"
start = {delta = 0.6, damping = false, c = [0.2]}
""",
    "matched": """
form = "matched"
structure = {A = [[1]], B = [-2]}
[plant]
name = "P"
profile = {"theta[1]" = [{constant = 3}, {sine = {amplitude = 0.6, omega = 1}}]}
[controller]
name = "C"
start = {delta = 0.6, damping = false}
""",
    "observer": """
form = "observer"
structure = {n = 1, m = 0}
[plant]
name = "P"
profile = {"theta[1]" = -2, "theta[2]" = [{sine = {amplitude = 0.6, omega = 1}}]}
[controller]
name = "C"
start = {delta = 0.6, delta_1 = 0.6, damping = false, sign_b_m = -1}
""",
}


@pytest.mark.parametrize("text", UNDAMPED.values(), ids=UNDAMPED)
def test_controller_2_of_first_order_holds_in_every_form(tmp_path, text):
    assert certified(tmp_path, text).verdict is Verdict.HOLDS


def test_a_projection_leaves_no_choice_of_ell(tmp_path):
    """inf theta(t) is not in the box about the centre, and so Controller 2 has no certificate."""
    profile = '"theta[1]" = [{constant = 2}, {sine = {amplitude = 3, omega = 1}}]'
    box = (
        "delta = 3, damping = {}, projection_box = true, theta_half_width = [1], theta_center = [2]"
    )
    assert certified(tmp_path, first_order(profile, box.format("true"))).holds
    found = certified(tmp_path, first_order(profile, box.format("false")))
    assert found.verdict is Verdict.VIOLATED


@pytest.mark.parametrize(("corrected", "verdict"), [("true", "HOLDS"), ("false", "VIOLATED")])
def test_printed_damping_is_caught(tmp_path, corrected, verdict):
    """(59) as printed fails where the corrected damping of the same gains holds."""
    text = (ROOT / "specs" / "output_feedback.toml").read_text("utf-8")
    text = text.replace("start = {c =", f"start = {{corrected = {corrected}, c =")
    assert certified(tmp_path, text).verdict is Verdict[verdict]


@pytest.mark.parametrize(
    ("n", "m", "b", "zero"),
    [
        (
            3,
            1,
            (0.5, -1.0),
            "0.5 s - 1 is not Hurwitz (Assumption 2): the plant has a zero at s = 2,",
        ),
        (2, 1, (1.0, 0.0), "1 s is not Hurwitz (Assumption 2): the plant has a zero at s = 0,"),
        (
            3,
            2,
            (1.0, 0.0, 4.0),
            "1 s^2 + 4 is not Hurwitz (Assumption 2): the plant has a zero at s = 0 +- 2i,",
        ),
        (3, 2, (1.0, -1.0, 1.0), "zero at s = 0.5 +- 0.866025i,"),
        (3, 2, (1.0, -1.0, -2.0), "zero at s = 2,"),
    ],
)
def test_unstable_zeros_are_named(tmp_path, n, m, b, zero):
    r = ", r = 40" if n == 3 else ""
    found = certified(tmp_path, observer(n, m, profiles(b, n), "delta = 0.3, delta_1 = 0.3" + r))
    assert found.verdict is Verdict.ASSUMPTION_BROKEN
    assert found.finding is None
    (reason,) = found.reasons
    assert zero in reason
    assert reason.startswith(f'plant.profile."theta[{m + 1}]": ')


@pytest.mark.parametrize("b", [(2.0,), (-2.0,), (1.0, 3.0), (-1.0, -3.0), (1.0, 2.0, 5.0)])
def test_hurwitz_numerators_of_either_sign_pass(tmp_path, b):
    n, m = max(2, len(b)), len(b) - 1
    sign = math.copysign(1, b[0])
    start = f"delta = 0.3, delta_1 = 0.3, sign_b_m = {sign}"
    assert certified(tmp_path, observer(n, m, profiles(b, n), start)).holds


@pytest.mark.parametrize(
    "term", ["{sine = {amplitude = 0.2, omega = 1}}", "{square = {amplitude = 0.2, period = 1}}"]
)
@pytest.mark.parametrize("j", [1, 2])
def test_b_has_to_be_constant_in_output_feedback(tmp_path, term, j):
    b = profiles((0.5, 1.0), 3)
    value = (0.5, 1.0)[j - 1]
    text = b.replace(CONSTANT.format(j, value), f'"theta[{j}]" = [{{constant = {value}}}, {term}]')
    found = certified(tmp_path, observer(3, 1, text))
    assert found.verdict is Verdict.ASSUMPTION_BROKEN
    (reason,) = found.reasons
    assert reason.startswith(
        f'plant.profile."theta[{j}]": b_{2 - j} varies between {value - 0.2:g}'
    )
    assert f"[{{constant = {value:g}}}]" in reason


@pytest.mark.parametrize(("sign", "b"), [(1, -1.5), (-1, 1.5)])
def test_the_stated_sign_of_b_m_has_to_be_its_sign(tmp_path, sign, b):
    start = f"delta = 0.3, delta_1 = 0.3, sign_b_m = {sign}"
    found = certified(tmp_path, observer(2, 0, profiles((b,), 2), start))
    assert found.verdict is Verdict.ASSUMPTION_BROKEN
    assert found.reasons == (
        f"controller.start.sign_b_m: it is {sign:+d}, while b_0 = theta[1] is "
        f"{'negative' if b < 0 else 'positive'}, {b} (Assumption 3); give sign_b_m = {-sign}",
    )


def test_b_m_that_is_0_has_no_sign(tmp_path):
    found = certified(tmp_path, observer(3, 1, profiles((0.0, 1.0), 3)))
    assert found.verdict is Verdict.ASSUMPTION_BROKEN
    assert "b_1 is 0 or passes through 0" in found.reasons[0]


SWING = "\n".join(
    f'"theta[{j}]" = [{{constant = 1}}, {{sine = {{amplitude = {a}, omega = {j}}}}}]'
    for j, a in ((1, 0.8), (2, 0.6))
)


BELOW = {
    "given": (
        strict(SWING, "delta = 0.3"),
        "controller.start.delta: 0.3 is less than 1, the radius of the box that theta(t) fills; "
        "give delta = 1, or narrow the profile",
    ),
    "0": (
        strict(SWING, "delta = 0"),
        "controller.start.delta: 0 is less than 1, the radius of the box that theta(t) fills; "
        "give delta = 1, or narrow the profile",
    ),
    "left out": (
        strict(SWING.replace("0.6", "0.9"), "epsilon = 1"),
        "controller.start.delta: it is left out, and so 1, which is less than 1.20416, the radius "
        "of the box that theta(t) fills; give delta = 1.20416, or narrow the profile "
        "(docs/theory.md, 'The idea')",
    ),
    "scalar": (
        first_order('"theta[1]" = [{sine = {amplitude = 2, omega = 1}}]', "delta = 1"),
        "controller.start.delta: 1 is less than 2, the radius of the box that theta(t) fills; "
        "give delta = 2, or narrow the profile",
    ),
    "delta_1": (
        observer(2, 0, profiles((1.0,), 2), "delta = 0.3, delta_1 = 0.1"),
        "controller.start.delta_1: 0.1 is less than 0.3, the radius of the interval that "
        "a_(n-1)(t) = theta[2] fills; give delta_1 = 0.3, or narrow the profile",
    ),
    "output feedback": (
        observer(2, 0, profiles((1.0,), 2), "delta = 0.1, delta_1 = 0.3"),
        "controller.start.delta: 0.1 is less than 0.3, the radius of the box that theta(t) fills; "
        "give delta = 0.3, or narrow the profile",
    ),
}


@pytest.mark.parametrize(("text", "reason"), BELOW.values(), ids=BELOW)
def test_delta_below_the_radius_of_the_box_is_refused_with_the_value_that_would_do(
    tmp_path, text, reason
):
    found = certified(tmp_path, text)
    assert found.verdict is Verdict.ASSUMPTION_BROKEN
    assert not found.holds
    assert found.reasons == (reason,)


def test_the_radius_that_the_message_names_does(tmp_path):
    for start in ("delta = 1", "delta = 1.20416"):
        text = strict(SWING.replace("0.6", "0.9"), start)
        assert certified(tmp_path, text).holds is (start != "delta = 1")


def test_what_is_left_out_but_covers_theta_is_a_warning(tmp_path):
    found = certified(tmp_path, strict(SWING.replace("0.6", "0.3"), "epsilon = 1"))
    assert found.verdict is Verdict.HOLDS
    (line,) = found.warnings
    assert line == (
        "controller.start.delta: it is left out, and so 1, which covers 0.8544, the radius of the "
        "box that theta(t) fills; give delta = 0.8544, or more (docs/theory.md, 'The idea')"
    )


def test_theta_without_a_profile_is_named(tmp_path):
    found = certified(tmp_path, strict(SWING.split("\n")[0], "delta = 1"))
    assert found.verdict is Verdict.HOLDS
    (line,) = found.warnings
    assert line.startswith('plant.profile."theta[2]": it has no profile, and is 0 throughout')
    none = certified(tmp_path, observer(2, 0, ""))
    (line,) = none.warnings
    assert "theta[1]" in line
    assert "and theta[2], theta[3] have no profile" in line


def test_tables_and_random_terms_are_one_warning(tmp_path):
    text = strict(
        '"theta[1]" = [{table = {times = [0, 1], values = [1, 2]}}]\n'
        '"theta[2]" = [{telegraph = {amplitude = 0.3, rate = 1, seed = 1}}]',
        "delta = 1",
    )
    found = certified(tmp_path, text)
    assert found.verdict is Verdict.HOLDS
    (line,) = found.warnings
    assert "theta[1] is read from a table" in line
    assert "theta[2] has a random term" in line


@pytest.mark.parametrize(
    ("text", "culprit"),
    [
        (first_order(CONSTANT.format(1, 1.0), "delta = 1, epsilon = 1e-12"), "epsilon = 1e-12"),
        (first_order(CONSTANT.format(1, 1.0), "delta = 1, epsilon = 1e-9"), "epsilon = 1e-09"),
        (first_order(CONSTANT.format(1, 1.0), "delta = 1, epsilon = 1e12"), "1000000000000.0"),
        (first_order(CONSTANT.format(1, 1.0), "delta = 1, k_bar = 1e-14"), "k_bar = 1e-14"),
        (strict(SWING, "delta = 1, epsilon = 1e-12"), "epsilon = 1e-12"),
        (strict(SWING, "delta = 1, epsilon = 1e-5"), "epsilon = 1e-05"),
        (strict(SWING, "delta = 1e30"), "delta = 1e+30"),
    ],
)
def test_numbers_that_double_precision_cannot_hold_together(tmp_path, text, culprit):
    found = certified(tmp_path, text)
    assert found.verdict is Verdict.PRECISION
    assert culprit in found.reasons[0]


LAWS = {
    "leakage": ("sigma = 0.1", Verdict.HOLDS),
    "leakage about a centre": ("sigma = 0.4, theta_center = {c}", Verdict.HOLDS),
    "switching leakage": ("sigma = 0.5, switching = true, theta_bound = 5", Verdict.HOLDS),
    "ball": ("projection_ball = true, theta_bound = 5", Verdict.HOLDS),
    "box": ("projection_box = true, theta_half_width = {w}", Verdict.HOLDS),
    "box and leakage": (
        "projection_box = true, theta_half_width = {w}, sigma = 0.2",
        Verdict.HOLDS,
    ),
    "small ball": ("projection_ball = true, theta_bound = 0.01", Verdict.ASSUMPTION_BROKEN),
    "small box": ("projection_box = true, theta_half_width = {t}", Verdict.ASSUMPTION_BROKEN),
    "small switching": (
        "sigma = 1, switching = true, theta_bound = 0.01",
        Verdict.ASSUMPTION_BROKEN,
    ),
    "frozen": ("adapt = false", Verdict.NOT_CLAIMED),
    "dead zone": ("dead_zone = 0.1", Verdict.NOT_CLAIMED),
}
FORMS = {
    "scalar": (
        1,
        lambda law: first_order(
            '"theta[1]" = [{constant = 2}, {sine = {amplitude = 0.5, omega = 1}}]',
            f"delta = 0.5, {law}",
        ),
    ),
    "state feedback": (2, lambda law: strict(SWING, f"delta = 1, {law}")),
    "output feedback": (
        3,
        lambda law: observer(
            2,
            0,
            profiles((1.5,), 2),
            "delta = 0.3, delta_1 = 0.3, "
            + law
            + (", rho_bound = 5" if "bound" in law and "0.01" not in law else "")
            + (", rho_half_width = 5" if "half_width" in law and "0.01" not in law else ""),
        ),
    ),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("law", LAWS)
def test_each_adaptation_law_has_its_own_claim(tmp_path, form, law):
    p, text = FORMS[form]
    settings, verdict = LAWS[law]
    vectors = {"c": [1.0] * p, "w": [4.0] * p, "t": [0.01] * p}
    for key, value in vectors.items():
        settings = settings.replace(f"{{{key}}}", str(value))
    found = certified(tmp_path, text(settings))
    assert found.verdict is verdict, found.reasons
    if verdict is Verdict.ASSUMPTION_BROKEN:
        assert "the set of the adaptation law does not hold" in found.reasons[0]
    if verdict is Verdict.NOT_CLAIMED:
        assert "(ell - theta_hat)^T" in found.reasons[0]


def test_matched_designs_with_leakage_hold(tmp_path):
    text = (ROOT / "specs" / "matched_pendulum.toml").read_text("utf-8")
    assert certified(tmp_path, text.replace("rho = 2,", "rho = 2, sigma = 0.1,")).holds


def test_a_set_that_holds_what_it_has_to_once_it_is_changed_as_the_message_says(tmp_path):
    text = strict(SWING, "delta = 1, projection_ball = true, theta_bound = 0.5")
    found = certified(tmp_path, text)
    assert found.verdict is Verdict.ASSUMPTION_BROKEN
    assert "theta_bound = 1.41421 or more, or theta_center = [1, 1]" in found.reasons[0]
    assert certified(tmp_path, text.replace("theta_bound = 0.5", "theta_bound = 1.42")).holds


def test_warnings_of_a_build_are_lines_of_text(tmp_path):
    file = tmp_path / "spec.toml"
    file.write_text(strict(SWING, "delta = 0.3"))
    assert spec_warnings(read_spec(file)) == (
        "controller.start.delta: 0.3 is less than 1, the radius of the box that theta(t) fills; "
        "give delta = 1, or narrow the profile",
    )


def test_neither_spec_nor_scenario(tmp_path):
    file = tmp_path / "other.toml"
    file.write_text("colour = 'green'\n")
    with pytest.raises(InvalidInput, match="colour is not known"):
        designs_of(file)
