"""Labels print the paper's symbols."""

from __future__ import annotations

import pytest

from congelation.results.labels import math_label, with_unit


@pytest.mark.parametrize(
    ("variable", "label"),
    [
        ("u", "$u$"),
        ("x[1]", "$x_{1}$"),
        ("theta[12]", r"$\theta_{12}$"),
        ("theta_hat[1]", r"$\hat{\theta}_{1}$"),
        ("theta_hat", r"$\hat{\theta}$"),
        ("rho_hat", r"$\hat{\rho}$"),
        ("Gamma[1,2]", r"$\Gamma_{1,2}$"),
        ("der(x[1])", r"$\dot{x}_{1}$"),
        ("speed[2]", r"$\mathrm{speed}_{2}$"),
        ("next_event", "next_event"),
        ("profile[1].mean", "profile[1].mean"),
        ("cost_in_$", r"cost\_in\_\$"),
    ],
)
def test_variables(variable: str, label: str) -> None:
    assert math_label(variable) == label


@pytest.mark.parametrize(
    ("unit", "text"),
    [
        ("", "x"),
        ("1", "x"),
        ("s", "x [s]"),
        ("1/s2", "x [1/s$^{2}$]"),
        ("m/s^2", "x [m/s$^{2}$]"),
        ("kg.m2.s-2", "x [kg.m$^{2}$.s$^{-2}$]"),
    ],
)
def test_units(unit: str, text: str) -> None:
    assert with_unit("x", unit) == text
