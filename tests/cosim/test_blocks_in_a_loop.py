"""Noise, saturation, lag and delay in a loop, against a monolithic solution."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from congelation.cosim import Component, Connection, Status, System, simulate
from congelation.signals import Noise, Profile, Sine, Square, profile
from congelation.theory.closed_loop import Compiled
from congelation.theory.state_feedback import state_feedback_controller
from congelation.theory.strict_feedback import SYSTEM_60, strict_feedback_plant
from congelation.theory.values import complete_values

FMUS = Path(__file__).parents[2] / "fmus"
STOP, SAMPLE, DELAY, T, LIMIT = 0.5, 0.05, 0.03, 0.02, 4.0
X0 = (1.0, -0.5)
THETA = (profile(-3.0, Sine(0.6, 0.4), Square(0.4, 0.7)), profile(2.0, Sine(0.4, 5.0)))
NOISE = (profile(Noise(0.02, SAMPLE, 3)), profile(Noise(0.05, SAMPLE, 4)))


def monolithic(times: np.ndarray) -> np.ndarray:
    """x, theta_hat, the lag's state and the control at `times`, by the method of steps.

    The delay, the samples of the noise and the jumps of theta are multiples of 0.01 s, so all that
    jumps or bends jumps or bends there; between, the delayed control is known from before.
    """
    plant, law = strict_feedback_plant(SYSTEM_60), state_feedback_controller(SYSTEM_60)
    values = complete_values(law, {"c": [0.5, 0.5], "epsilon": 0.3, "damping": [0.0]})
    named = law.arguments()
    (theta_hat,), (y,) = law.states, law.inputs
    symbols = [named[name] for name in values]
    numbers = [ca.SX(ca.DM(value)) for value in values.values()]
    expressions = ca.substitute([theta_hat.rate, law.output("u")], symbols, numbers)
    bound = Compiled(expressions, [theta_hat.variables.symbol, y.variables.symbol])
    (x,), (u,) = plant.states, plant.inputs
    assert plant.theta is not None
    moved = Compiled([x.rate], [x.variables.symbol, u.variables.symbol, plant.theta.symbol])

    grid = 0.01
    history: list = []
    state = np.array([*X0, 0.0, 0.0, 0.0])
    rows = []
    for k in range(round(STOP / grid)):
        start, end = k * grid, (k + 1) * grid
        # Asked at the middle, a profile gives the piece without any rounding of its jumps.
        middle = (start + end) / 2
        n = np.array([p.value(middle) for p in NOISE])
        pieces = [p.segment(middle) for p in THETA]
        late = round(DELAY / grid)

        def control(X: np.ndarray, n: np.ndarray = n) -> tuple[np.ndarray, float]:
            *rate, v = bound(X[2:4], X[:2] + n)
            return np.array(rate), v

        def arrived(t: float, k: int = k, late: int = late) -> float:
            return history[k - late](t - DELAY)[4] if k >= late else 0.0

        def rates(t, X, pieces=pieces, control=control, arrived=arrived):
            rate, v = control(X)
            theta = [piece.value(t) for piece in pieces]
            lagged = (np.clip(v, -LIMIT, LIMIT) - X[4]) / T
            return [*moved(X[:2], [arrived(t)], theta), *rate, lagged]

        inside = times[(times > start - 1e-9) & (times < end - 1e-9)]
        found = solve_ivp(
            rates, (start, end), state, "DOP853", dense_output=True, rtol=1e-10, atol=1e-12
        )
        history.append(found.sol)
        rows += [[*found.sol(t), control(found.sol(t))[1]] for t in inside]
        state = found.y[:, -1]
    return np.array(rows)


def test_a_loop_through_all_blocks() -> None:
    def flat(of: Profile, j: int) -> dict[str, object]:
        return {f"profile[{j}].{k}": v for k, v in of.to_flat().items()}

    noises = [
        Component(f"noise{j}", FMUS / "Noise.fmu", _noise_start(of))
        for j, of in enumerate(NOISE, 1)
    ]
    plant_start = {"x0": X0, **flat(THETA[0], 1), **flat(THETA[1], 2)}
    law_start = {"c": [0.5, 0.5], "epsilon": 0.3, "damping": False}
    components = (
        Component("plant", FMUS / "StrictFeedbackPlant.fmu", plant_start),
        *noises,
        Component("law", FMUS / "StateFeedbackController.fmu", law_start),
        Component("saturation", FMUS / "Saturation.fmu", {"limit": [LIMIT]}),
        Component("lag", FMUS / "Lag.fmu", {"T": [T]}),
        Component("delay", FMUS / "Delay.fmu", {"delay": DELAY}),
    )
    chain = (
        ("plant.x[1]", "noise1.u"),
        ("plant.x[2]", "noise2.u"),
        ("noise1.y", "law.x[1]"),
        ("noise2.y", "law.x[2]"),
        ("law.u", "saturation.u"),
        ("saturation.y", "lag.u"),
        ("lag.y", "delay.u"),
        ("delay.y", "plant.u"),
    )
    system = System(components, tuple(Connection(*link) for link in chain))
    record = ["plant.x", "law.theta_hat", "lag.y", "law.u", "saturation.saturated"]
    result = simulate(
        system,
        stop_time=STOP,
        tolerance=1e-7,
        coupling="hermite",
        record=record,
    )
    assert result.status is Status.COMPLETED, result.message
    column = {name: result.values[:, k] for k, name in enumerate(result.names)}
    assert {*column["saturation.saturated[1]"]} >= {-1.0, 0.0}  # both pieces have been met

    # Rows at jumps are twice there, from the left and from the right; those between are compared.
    away = np.abs(result.time / 0.01 - np.round(result.time / 0.01)) > 1e-6
    assert away.sum() > 100
    exact = monolithic(result.time[away])
    names = ["plant.x[1]", "plant.x[2]", "law.theta_hat[1]", "law.theta_hat[2]"]
    names += ["lag.y[1]", "law.u"]
    for name, values in zip(names, exact.T, strict=True):
        error = np.max(np.abs(column[name][away] - values))
        assert error < 1e-5 * np.max(np.abs(values)), name


def _noise_start(of: Profile) -> dict[str, object]:
    (term,) = of.terms
    assert isinstance(term, Noise)
    names = ("deviation", "sample_time", "seed")
    return {f"profile[1].noise[1].{name}": getattr(term, name) for name in names}
