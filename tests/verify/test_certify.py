"""`certify` passes the certified designs, and catches the printed ones and the classical ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from congelation.errors import InvalidInput
from congelation.verify.certify import certify, designs_of

ROOT = Path(__file__).resolve().parents[2]
SPECS = sorted((ROOT / "specs").glob("*.toml"))


@pytest.mark.parametrize("file", SPECS, ids=lambda file: file.stem)
def test_shipped_specs_hold(file):
    (design,) = designs_of(file)
    found = certify(design, samples=100)
    assert not found.finding.violated, found.finding
    assert not found.leaves_ball


def test_controller_2_is_caught():
    """Without damping nothing is promised for a theta that varies: the search finds where."""
    one, two = designs_of(ROOT / "scenarios" / "fig2.toml")
    assert certify(one, samples=200).holds
    found = certify(two, samples=200)
    assert found.finding.violated
    assert found.finding.margin.value > 0.0


@pytest.mark.parametrize(("certified", "violated"), [("true", False), ("false", True)])
def test_printed_damping_is_caught(tmp_path, certified, violated):
    """(59) as printed fails where the corrected damping of the same gains holds."""
    text = (ROOT / "specs" / "output_feedback.toml").read_text("utf-8")
    file = tmp_path / "spec.toml"
    file.write_text(text.replace("start = {c =", f"start = {{certified = {certified}, c ="))
    (design,) = designs_of(file)
    assert certify(design, samples=200).finding.violated is violated


def test_profile_outside_the_ball(tmp_path):
    text = (ROOT / "specs" / "scalar.toml").read_text("utf-8")
    file = tmp_path / "small.toml"
    file.write_text(text.replace("delta = 1}", "delta = 0.5}"))
    (design,) = designs_of(file)
    found = certify(design, samples=50)
    assert found.leaves_ball
    assert not found.holds


def test_neither_spec_nor_scenario(tmp_path):
    file = tmp_path / "other.toml"
    file.write_text("colour = 'green'\n")
    with pytest.raises(InvalidInput, match="colour is not known"):
        designs_of(file)
