"""Metrics against closed forms, invariances, and metrics of installed packages."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from congelation.errors import InvalidInput
from congelation.scenario.metrics import ENTRY_POINTS, METRICS, metric, norm

TIME = np.linspace(2.0, 22.0, 20001)  # starts at 2: nothing may assume that runs start at 0
S = TIME - TIME[0]
DECAY = np.exp(-S)[:, np.newaxis]
SPIRAL = np.column_stack([np.exp(-S) * np.cos(7 * S), np.exp(-S) * np.sin(7 * S)])


@pytest.mark.parametrize("values", [DECAY, SPIRAL, -DECAY], ids=["decay", "spiral", "negative"])
@pytest.mark.parametrize(
    ("name", "options", "exact"),
    [
        ("peak", {}, 1.0),
        ("settling_time", {"below": 1e-2}, math.log(100.0)),
        ("integral_of_square", {}, 0.5),
        ("ise", {}, 0.5),
        ("iae", {}, 1.0),
        ("itae", {}, 1.0),
        ("drift", {}, 1.0),
    ],
)
def test_exponential_decay(
    name: str, options: dict[str, float], exact: float, values: np.ndarray
) -> None:
    assert METRICS[name].evaluate(TIME, values, **options) == pytest.approx(exact, rel=1e-5)


def test_integrals_are_accurate_on_the_long_steps_of_a_decay() -> None:
    """Steps that grow with time, 60 in all; trapezoidal sums are off by 4e-3 there."""
    time = 20.0 * np.linspace(0.0, 1.0, 61) ** 2
    values = np.exp(-time)[:, np.newaxis]
    assert abs(np.trapezoid(values[:, 0] ** 2, time) - 0.5) > 1e-3
    assert METRICS["ise"].evaluate(time, values) == pytest.approx(0.5, rel=1e-3)
    assert METRICS["iae"].evaluate(time, values) == pytest.approx(1.0, rel=1e-3)


@given(st.lists(st.sampled_from([0.0, 1.0, 5.0]), min_size=2, max_size=20))
def test_integrals_do_not_overshoot_where_signals_jump(levels: list[float]) -> None:
    """Between two rows the integrand stays between their values."""
    time = np.arange(len(levels), dtype=float)
    size = np.array(levels)
    least = np.minimum(size[:-1], size[1:]).sum()
    most = np.maximum(size[:-1], size[1:]).sum()
    assert least - 1e-9 <= METRICS["iae"].evaluate(time, size[:, np.newaxis]) <= most + 1e-9


def test_every_metric_is_tested_and_defined() -> None:
    tested = {"peak", "settling_time", "integral_of_square", "ise", "iae", "itae", "drift"}
    assert set(METRICS) == tested | {
        "overshoot",
        "lyapunov",
        "lyapunov_share",
        "ultimate_bound",
        "ultimate_share",
        "deviation",
    }
    for name, entry in METRICS.items():
        assert entry.name == name
        assert any(char.isdigit() for char in entry.definition), "cites no source"


def test_settling_at_once_and_never() -> None:
    settling = METRICS["settling_time"].evaluate
    time = np.array([0.0, 1.0, 2.0])
    assert settling(time, np.array([[0.1], [0.1], [0.0]]), below=0.1) == 0.0
    assert settling(time, np.array([[0.0], [0.0], [0.2]]), below=0.1) == math.inf
    assert settling(time, np.array([[0.0], [0.2], [0.0]]), below=0.1) == pytest.approx(1.5)


def test_overshoot_of_a_second_order_step() -> None:
    damping = 0.3
    root = math.sqrt(1 - damping**2)
    step = 1 - np.exp(-damping * S) * (np.cos(root * S) + damping / root * np.sin(root * S))
    found = METRICS["overshoot"].evaluate(TIME, step[:, np.newaxis], reference=1.0)
    assert found == pytest.approx(math.exp(-math.pi * damping / root), rel=1e-5)
    assert METRICS["overshoot"].evaluate(TIME, DECAY) == 0.0
    assert METRICS["overshoot"].evaluate(TIME, DECAY, reference=1.0) is None


@given(st.lists(st.lists(st.floats(-1e150, 1e150), min_size=3, max_size=3), min_size=1, max_size=9))
def test_norm_neither_overflows_nor_underflows(rows: list[list[float]]) -> None:
    values = np.array(rows)
    assert norm(values) == pytest.approx([math.hypot(*row) for row in rows], rel=1e-14, abs=0.0)
    scaled = norm(values * 2.0**500) if np.max(np.abs(values)) < 1e100 else norm(values)
    assert np.all(np.isfinite(scaled))


def test_peak_from_a_time_on() -> None:
    later = METRICS["peak"].evaluate(TIME, DECAY, after=TIME[0] + 1.0)
    assert later == pytest.approx(math.exp(-1.0), rel=1e-3)
    assert METRICS["peak"].evaluate(TIME, DECAY, after=TIME[-1] + 1.0) is None


@given(st.floats(0.01, 100.0), st.sampled_from(["peak", "iae", "drift"]))
def test_scaling_a_signal_scales_its_metrics(factor: float, name: str) -> None:
    one = METRICS[name].evaluate(TIME[:500], SPIRAL[:500])
    assert METRICS[name].evaluate(TIME[:500], factor * SPIRAL[:500]) == pytest.approx(factor * one)


def test_units() -> None:
    assert METRICS["peak"].unit("m") == "m"
    assert METRICS["settling_time"].unit("m") == "s"
    assert METRICS["ise"].unit("m/s") == "(m/s)^2 s"
    assert METRICS["iae"].unit("m") == "m s"
    assert METRICS["iae"].unit("") == "s"
    assert METRICS["overshoot"].unit("m") == ""


def test_options_and_sizes() -> None:
    assert METRICS["settling_time"].options == {"below": True}
    assert METRICS["overshoot"].options == {"reference": False}
    assert METRICS["peak"].options == {"after": False}
    assert METRICS["drift"].options == {}
    METRICS["overshoot"].check_size(1)
    METRICS["peak"].check_size(3)
    with pytest.raises(InvalidInput, match="overshoot is of one variable, not of a group of 2"):
        METRICS["overshoot"].check_size(2)


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package that offers one good metric and two broken ones, installed as pip does."""
    (tmp_path / "my_metrics.py").write_text(
        "from congelation.scenario.metrics import Metric\n"
        "last = Metric('last', lambda time, values: float(values[-1, 0]), 'v(T)', str)\n"
        "number = 3\n"
    )
    info = tmp_path / "my_metrics-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-metrics\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        f"[{ENTRY_POINTS}]\nlast = my_metrics:last\nwrong = my_metrics:number\n"
        "absent = my_metrics:absent\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "my_metrics", raising=False)


@pytest.mark.usefixtures("installed")
def test_metrics_of_installed_packages() -> None:
    assert metric("last").evaluate(TIME, DECAY) == DECAY[-1, 0]
    with pytest.raises(InvalidInput, match=r"'wrong' is my_metrics:number, which is not a Metric"):
        metric("wrong")
    with pytest.raises(InvalidInput, match="'absent' cannot be loaded"):
        metric("absent")
    with pytest.raises(InvalidInput, match=r"'lsat' is no metric; did you mean 'last'\?"):
        metric("lsat")


def test_an_unknown_metric_names_the_nearest() -> None:
    assert metric("peak") is METRICS["peak"]
    with pytest.raises(InvalidInput, match="'setling_time' is no metric; did you mean 'settling"):
        metric("setling_time")


@pytest.mark.parametrize("count", [2, 3, 4, 50])
def test_the_integral_is_that_of_scipy_s_monotone_cubic(count: int) -> None:
    rng = np.random.default_rng(count)
    for _ in range(50):
        time = np.cumsum(rng.uniform(1e-3, 1.0, count))
        # Small integers: data that turn, stay level, and have zeros.
        values = rng.integers(-3, 4, count).astype(np.float64)
        integrand = norm(values[:, np.newaxis]) ** 2
        wanted = PchipInterpolator(time, integrand).integrate(time[0], time[-1])
        found = METRICS["ise"].evaluate(time, values[:, np.newaxis])
        np.testing.assert_allclose(found, wanted, rtol=1e-13, atol=1e-13)
