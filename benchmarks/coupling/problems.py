"""The coupling problems: parts, connections, and solutions that owe nothing to any co-simulation.

Systems of linear parts are put together as matrices, whose exponential is the exact solution. The
equations of the others are written down once more as one system, which scipy's DOP853 solves with a
relative tolerance of 1e-13; switching relays are events of it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from benchmarks.coupling.parts import MODELS
from congelation.cosim import Component, Connection, System

__all__ = ["PROBLEMS", "REFERENCE", "Linear", "Problem", "Smooth", "Switched", "problem"]

Floats = npt.NDArray[np.float64]
Start = Mapping[str, float]

X, U, Y = 4, 2, 2
"""States, inputs and outputs of every linear part."""

DENSE = 0.5
"""Of the coarsest communication step, the longest of the reference solver: within its steps it
interpolates to order 7 only."""

REFERENCE: Mapping[str, Any] = MappingProxyType({"method": "DOP853", "rtol": 1e-13, "atol": 1e-14})
"""How reference solutions are found."""


class Solution(Protocol):
    """The recorded variables as functions of time."""

    def __call__(self, problem: Problem, times: Floats) -> Floats:
        """At increasing times, shape (N,); shape (N, M)."""

    def solved(self, problem: Problem, times: Floats, **how: Any) -> Floats:
        """The same by a solver: `how` are arguments of scipy's solve_ivp."""


@dataclass(frozen=True)
class Problem:
    """A coupled system with its solution.

    Parameters
    ----------
    name, title : str
    source : str
        Where it is from.
    parts : mapping of str to (str, mapping)
        The model of each part, and its start values.
    links : tuple of str
        ``a.y -> b.u``.
    record : tuple of str
    stop : float
        Seconds.
    steps : tuple of float
        Communication steps from coarse to fine, in seconds.
    solution : Solution
    known : bool
        Whether it was among those that the error bars were devised on.
    chaotic : bool
    """

    name: str
    title: str
    source: str
    parts: Mapping[str, tuple[str, Start]]
    links: tuple[str, ...]
    record: tuple[str, ...]
    stop: float
    steps: tuple[float, ...]
    solution: Solution
    known: bool = True
    chaotic: bool = False

    def __reduce__(self) -> tuple[Callable[[str], Problem], tuple[str]]:
        """Processes send each other its name: functions cannot be sent."""
        return problem, (self.name,)

    def system(self, folder: Path, ability: str) -> System:
        """Of the FMUs in a folder that have an ability, see `parts.ABILITIES`."""
        return System(
            tuple(
                Component(name, folder / f"{model}_{ability}.fmu", dict(start))
                for name, (model, start) in self.parts.items()
            ),
            tuple(Connection.parse(link) for link in self.links),
        )

    def exact(self, times: Floats) -> Floats:
        """The recorded variables, shape (N, M), at increasing times, shape (N,)."""
        return self.solution(self, times)


# -- solutions ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Linear:
    """The exact solution of linear parts."""

    def equations(self, problem: Problem) -> tuple[Floats, Floats, Floats]:
        """z' = F z, its start and the recorded variables R z: F, z0 and R."""
        names = list(problem.parts)
        n = len(names)
        A, B = np.zeros((n * X, n * X)), np.zeros((n * X, n * U))
        C, D = np.zeros((n * Y, n * X)), np.zeros((n * Y, n * U))
        K = np.zeros((n * U, n * Y))
        x0 = np.zeros(n * X)
        sizes = ((A, "A", X, X), (B, "B", X, U), (C, "C", Y, X), (D, "D", Y, U))
        for k, (_, start) in enumerate(problem.parts.values()):
            for M, letter, rows, columns in sizes:
                for i, j in itertools.product(range(rows), range(columns)):
                    value = start.get(f"{letter}[{i + 1},{j + 1}]", 0.0)
                    M[k * rows + i, k * columns + j] = value
            x0[k * X : (k + 1) * X] = [start.get(f"x0[{i + 1}]", 0.0) for i in range(X)]

        def output(name: str) -> int:
            part, variable = name.split(".")
            return names.index(part) * Y + MODELS["linear"].outputs.index(variable)

        for link in problem.links:
            source, target = link.split(" -> ")
            part, variable = target.split(".")
            row = names.index(part) * U + MODELS["linear"].inputs.index(variable)
            K[row, output(source)] = 1.0
        # y = C x + D K y, x' = A x + B K y
        y = np.linalg.solve(np.eye(n * Y) - D @ K, C)
        F = A + B @ K @ y
        moving = np.flatnonzero(F.any(axis=1) | (x0 != 0.0))
        recorded = y[np.ix_([output(name) for name in problem.record], moving)]
        return F[np.ix_(moving, moving)], x0[moving], recorded

    def __call__(self, problem: Problem, times: Floats) -> Floats:
        """At increasing times, shape (N,); shape (N, M)."""
        F, z0, recorded = self.equations(problem)
        return np.asarray(expm(F[None] * times[:, None, None]) @ z0 @ recorded.T)

    def solved(self, problem: Problem, times: Floats, **how: Any) -> Floats:
        """The same by a solver: `how` are arguments of scipy's solve_ivp."""
        F, z0, recorded = self.equations(problem)
        found = solve_ivp(lambda t, z: F @ z, (0.0, problem.stop), z0, t_eval=times, **how)
        return np.asarray(found.y.T @ recorded.T)


@dataclass(frozen=True)
class Smooth:
    """The reference solution of one system z' = f(t, z).

    Parameters
    ----------
    f : callable
        Of t and z.
    outputs : callable
        The recorded variables of z, shape (n, N); a sequence of M arrays.
    z0 : tuple of float
    """

    f: Callable[[float, Floats], Sequence[float]]
    outputs: Callable[[Floats], Sequence[Floats]]
    z0: tuple[float, ...]

    def __call__(self, problem: Problem, times: Floats) -> Floats:
        """At increasing times, shape (N,); shape (N, M)."""
        return self.solved(problem, times, max_step=DENSE * problem.steps[0], **REFERENCE)

    def solved(self, problem: Problem, times: Floats, **how: Any) -> Floats:
        """The same by a solver: `how` are arguments of scipy's solve_ivp."""
        found = solve_ivp(self.f, (0.0, problem.stop), self.z0, t_eval=times, **how)
        return np.column_stack(self.outputs(found.y))


@dataclass(frozen=True)
class Switched:
    """The reference solution of z' = f(t, z, r) with a relay: r is `high` once s(z) is below
    -band, `low` once it is above band.

    Parameters
    ----------
    f : callable
        Of t, z and r.
    s : callable
        Of z.
    outputs : callable
        The recorded variables of z, shape (n, N), and r, shape (N,).
    z0 : tuple of float
    low, high, band, r : float
        The last is r at the start.
    """

    f: Callable[[float, Floats, float], Sequence[float]]
    s: Callable[[Floats], float]
    outputs: Callable[[Floats, Floats], Sequence[Floats]]
    z0: tuple[float, ...]
    low: float
    high: float
    band: float
    r: float

    def pieces(
        self, problem: Problem, times: Floats, **how: Any
    ) -> tuple[list[float], Floats, Floats]:
        """When r switches; z, shape (n, N), and r, shape (N,), at the times."""
        time, stop, z, r = 0.0, problem.stop, np.array(self.z0), self.r
        switches: list[float] = []
        states, relays = np.empty((len(z), len(times))), np.empty(len(times))
        while time < stop:

            def level(_: float, z: Floats, r: float) -> float:
                return self.s(z) - self.band if r == self.high else self.s(z) + self.band

            level.terminal = True  # type: ignore[attr-defined]
            level.direction = 1.0 if r == self.high else -1.0  # type: ignore[attr-defined]
            found = solve_ivp(
                self.f, (time, stop), z, dense_output=True, args=(r,), events=level, **how
            )
            until = float(found.t[-1])
            here = (times >= time) & (times <= until)
            if here.any():
                states[:, here], relays[here] = found.sol(times[here]), r
            time, z = until, found.y[:, -1]
            if found.status == 1:
                switches.append(time)
                r = self.low if r == self.high else self.high
        return switches, states, relays

    def __call__(self, problem: Problem, times: Floats) -> Floats:
        """At increasing times, shape (N,); shape (N, M)."""
        return self.solved(problem, times, max_step=DENSE * problem.steps[0], **REFERENCE)

    def solved(self, problem: Problem, times: Floats, **how: Any) -> Floats:
        """The same by a solver: `how` are arguments of scipy's solve_ivp."""
        _, states, relays = self.pieces(problem, times, **how)
        return np.column_stack(self.outputs(states, relays))


# -- linear parts ---------------------------------------------------------------------------------


def _linear(
    A: Sequence[Sequence[float]] = (),
    B: Sequence[Sequence[float]] = (),
    C: Sequence[Sequence[float]] = (),
    D: Sequence[Sequence[float]] = (),
    x0: Sequence[float] = (),
) -> tuple[str, Start]:
    start = {
        f"{letter}[{i},{j}]": float(value)
        for letter, rows in (("A", A), ("B", B), ("C", C), ("D", D))
        for i, row in enumerate(rows, 1)
        for j, value in enumerate(row, 1)
        if value
    }
    start |= {f"x0[{i}]": float(value) for i, value in enumerate(x0, 1)}
    return "linear_direct" if D else "linear", start


def _integrator(x0: float = 0.0) -> tuple[str, Start]:
    """x' = u1, y1 = x."""
    return _linear([[0.0]], [[1.0]], [[1.0]], x0=[x0])


def _mass(m: float, c: float, d: float, x0: float, v0: float) -> tuple[str, Start]:
    """m x'' = u1 - c x - d x', y = (x, x')."""
    return _linear([[0, 1], [-c / m, -d / m]], [[0], [1 / m]], [[1, 0], [0, 1]], x0=[x0, v0])


def _sprung_mass(
    m: float, c: float, d: float, k: float, b: float, x0: float, v0: float
) -> tuple[str, Start]:
    """As _mass, on a spring k and damper b from a point (u1, u2) = (x, x')."""
    return _linear(
        [[0, 1], [-(c + k) / m, -(d + b) / m]],
        [[0, 0], [k / m, b / m]],
        [[1, 0], [0, 1]],
        x0=[x0, v0],
    )


def _pulling_mass(
    m: float, c: float, d: float, k: float, b: float, x0: float, v0: float
) -> tuple[str, Start]:
    """As _sprung_mass, y1 being the force on that point; y2 = x."""
    model, start = _sprung_mass(m, c, d, k, b, x0, v0)
    force = {"C[1,1]": k, "C[1,2]": b, "C[2,1]": 1.0, "C[2,2]": 0.0, "D[1,1]": -k, "D[1,2]": -b}
    return f"{model}_direct", {**start, **force}


_BOTH = ("left.y1 -> right.u1", "left.y2 -> right.u2")
_POINTS = (*_BOTH, "right.y1 -> left.u1", "right.y2 -> left.u2")
_FORCE = (*_BOTH, "right.y1 -> left.u1")
_SCHWEIZER = (
    "B. Schweizer, P. Li, D. Lu, Explicit and implicit cosimulation methods: stability and "
    "convergence analysis for different solver coupling approaches, J. Comput. Nonlinear Dynam. "
    "10 (2015) 051007"
)


def _two_masses(
    name: str,
    title: str,
    *,
    m: tuple[float, float] = (1.0, 1.0),
    c: tuple[float, float] = (10.0, 10.0),
    d: tuple[float, float] = (0.2, 0.2),
    k: float = 10.0,
    b: float = 0.2,
    force: bool = False,
    steps: tuple[float, ...] = (0.05, 0.02, 0.01, 0.005),
) -> Problem:
    right = _pulling_mass if force else _sprung_mass
    left = (
        _mass(m[0], c[0], d[0], 1.0, 0.0)
        if force
        else _sprung_mass(m[0], c[0], d[0], k, b, 1.0, 0.0)
    )
    return Problem(
        f"two_masses_{name}",
        f"two masses, {title}",
        _SCHWEIZER,
        {"left": left, "right": right(m[1], c[1], d[1], k, b, 0.0, 0.0)},
        _FORCE if force else _POINTS,
        ("left.y1", "left.y2", "right.y1", "right.y2"),
        10.0,
        steps,
        Linear(),
    )


def _added_mass(gain: float) -> Problem:
    """x1'' = (f - c x1 - d x1') / m, f = -gain m x1'' + k (x2 - x1) and a second mass."""
    k = 10.0
    left = _linear(
        [[0, 1], [-10.0, -0.2]],
        [[0], [1]],
        [[1, 0], [-10.0, -0.2]],
        [[0], [1]],
        [1.0, 0.0],
    )
    right = _linear([[0, 1], [-10.0 - k, -0.2]], [[0, 0], [k, 0]], [[k, 0], [1, 0]], [[-k, -gain]])
    return Problem(
        "two_masses_loop",
        "two masses, algebraic loop",
        _SCHWEIZER,
        {"left": left, "right": right},
        _FORCE,
        ("left.y1", "left.y2", "right.y1", "right.y2"),
        10.0,
        (0.05, 0.02, 0.01, 0.005),
        Linear(),
    )


def _algebraic_loop(gain: float) -> Problem:
    """Two filters that pass their inputs on at once, in a loop of gain -`gain`."""
    a = _linear([[-1.0]], [[1.0]], [[1.0]], [[gain]], [1.0])
    b = _linear([[-2.0]], [[1.0]], [[0.5]], [[-1.0]], [0.0])
    return Problem(
        f"algebraic_loop_{gain:g}",
        f"algebraic loop, gain {gain:g}",
        "R. Kübler, W. Schiehlen, Two methods of simulator coupling, Math. Comput. Model. Dyn. "
        "Syst. 6 (2000) 93",
        {"a": a, "b": b},
        ("a.y1 -> b.u1", "b.y1 -> a.u1"),
        ("a.y1", "b.y1"),
        5.0,
        (0.1, 0.05, 0.02, 0.01),
        Linear(),
    )


def _oscillator() -> Problem:
    """Two masses of 1 kg between three springs of 4 pi^2, 16 pi^2 and 4 pi^2 N/m."""
    c, k = 4.0 * math.pi**2, 16.0 * math.pi**2
    return Problem(
        "oscillator",
        "partitioned oscillator",
        "preCICE tutorials, partitioned oscillator, https://precice.org/tutorials-oscillator.html",
        {
            "left": _sprung_mass(1.0, c, 0.0, k, 0.0, 1.0, 0.0),
            "right": _sprung_mass(1.0, c, 0.0, k, 0.0, 0.0, 0.0),
        },
        _POINTS,
        ("left.y1", "left.y2", "right.y1", "right.y2"),
        1.0,
        (0.01, 0.005, 0.002, 0.001),
        Linear(),
    )


def _spring_damper() -> Problem:
    """A spring with damper, whose force follows at once from the place and speed of a mass."""
    return Problem(
        "spring_damper",
        "spring and damper against a mass",
        "arXiv:2512.13845, on drift under held inputs when macro steps change",
        {
            "mass": _mass(1.0, 0.0, 0.0, 0.1, 1.0),
            "spring": _linear(D=[[-50.0, -0.5]]),
        },
        ("mass.y1 -> spring.u1", "mass.y2 -> spring.u2", "spring.y1 -> mass.u1"),
        ("mass.y1", "mass.y2", "spring.y1"),
        5.0,
        (0.02, 0.01, 0.005, 0.002),
        Linear(),
    )


def _quarter_car() -> Problem:
    """Chassis 400 kg on 15 kN/m and 1 kN s/m, wheel 40 kg on a tyre of 150 kN/m, after a step of
    the road by 0.1 m."""
    return Problem(
        "quarter_car",
        "quarter car",
        "M. Arnold et al., Numerical methods in vehicle system dynamics: state of the art and "
        "current developments, Vehicle Syst. Dyn. 49 (2011) 1159; S. Sadjina et al., Energy "
        "conservation and power bonds in co-simulations, Eng. Comput. 33 (2017) 607",
        {
            "left": _mass(40.0, 150e3, 0.0, -0.1, 0.0),
            "right": _pulling_mass(400.0, 0.0, 0.0, 15e3, 1e3, -0.1, 0.0),
        },
        _FORCE,
        ("left.y1", "left.y2", "right.y1", "right.y2"),
        2.0,
        (5e-3, 2e-3, 1e-3, 5e-4),
        Linear(),
    )


def _chain() -> Problem:
    """Three integrators behind an oscillation."""
    return Problem(
        "chain",
        "chain of integrators",
        "M. Busch, Zur effizienten Kopplung von Simulationsprogrammen, Kassel (2012)",
        {
            "source": _linear([[0, 2], [-2, 0]], C=[[1, 0]], x0=[0.0, 1.0]),
            **{name: _integrator() for name in ("first", "second", "third")},
        },
        ("source.y1 -> first.u1", "first.y1 -> second.u1", "second.y1 -> third.u1"),
        ("source.y1", "first.y1", "second.y1", "third.y1"),
        10.0,
        (0.1, 0.05, 0.02, 0.01),
        Linear(),
    )


def _stiff_loop() -> Problem:
    """An oscillator under a PD controller, whose filter is a thousand times faster."""
    n = 1000.0
    return Problem(
        "stiff_loop",
        "stiff controller loop",
        "K. J. Åström, R. M. Murray, Feedback Systems, 2nd ed. (2021), section 11.5: filtered "
        "derivative action",
        {
            "plant": _mass(1.0, 1.0, 0.1, 1.0, 0.0),
            # f' = n (x - f), u = -(k x + d n (x - f))
            "controller": _linear([[-n]], [[n]], [[2.0 * n]], [[-4.0 - 2.0 * n]], [1.0]),
        },
        ("plant.y1 -> controller.u1", "controller.y1 -> plant.u1"),
        ("plant.y1", "plant.y2", "controller.y1"),
        5.0,
        (5e-3, 2e-3, 1e-3, 5e-4),
        Linear(),
    )


# -- other parts ----------------------------------------------------------------------------------


def _van_der_pol(mu: float, stop: float, steps: tuple[float, ...]) -> Problem:
    return Problem(
        f"van_der_pol_{mu:g}",
        f"Van der Pol, mu = {mu:g}",
        "E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section IV.1",
        {"place": _integrator(2.0), "speed": ("vanderpol", {"mu": mu})},
        ("place.y1 -> speed.u", "speed.y -> place.u1"),
        ("place.y1", "speed.y"),
        stop,
        steps,
        Smooth(lambda t, z: (z[1], mu * (1.0 - z[0] ** 2) * z[1] - z[0]), tuple, (2.0, 0.0)),
    )


def _lorenz() -> Problem:
    return Problem(
        "lorenz",
        "Lorenz",
        "E. N. Lorenz, Deterministic nonperiodic flow, J. Atmos. Sci. 20 (1963) 130",
        {
            "x": _linear([[-10.0]], [[10.0]], [[1.0]], x0=[1.0]),
            "yz": ("lorenz", {"r": 28.0, "b": 8.0 / 3.0, "x0[1]": 1.0, "x0[2]": 20.0}),
        },
        ("x.y1 -> yz.u", "yz.y1 -> x.u1"),
        ("x.y1", "yz.y1", "yz.y2"),
        20.0,
        (0.01, 0.005, 0.002, 0.001),
        Smooth(
            lambda t, z: (
                10.0 * (z[1] - z[0]),
                z[0] * (28.0 - z[2]) - z[1],
                z[0] * z[1] - 8.0 / 3.0 * z[2],
            ),
            tuple,
            (1.0, 1.0, 20.0),
        ),
        chaotic=True,
    )


_RELAY = {"low": -1.0, "high": 1.0, "band": 0.1}


def _relay() -> Problem:
    """The limit cycle of a damped second-order system under a relay with hysteresis."""
    return Problem(
        "relay",
        "relay",
        "Ya. Z. Tsypkin, Relay Control Systems (1984)",
        {"plant": _mass(1.0, 1.0, 1.0, 1.0, 0.0), "relay": ("relay", {**_RELAY, "x0": -1.0})},
        ("plant.y1 -> relay.u", "relay.y -> plant.u1"),
        ("plant.y1", "plant.y2", "relay.y"),
        10.0,
        (0.05, 0.02, 0.01, 0.005),
        Switched(
            lambda t, z, r: (z[1], r - z[0] - z[1]),
            lambda z: float(z[0]),
            lambda z, r: (*z, r),
            (1.0, 0.0),
            **_RELAY,
            r=-1.0,
        ),
    )


def _thermostat() -> Problem:
    """A room of time constant 5 s that cools towards -1; a heater is on below -0.2 and off above
    0.2; the sensor lags by 0.5 s."""
    limits = {"low": 0.0, "high": 2.0, "band": 0.2}
    return Problem(
        "thermostat",
        "thermostat",
        "T. A. Henzinger, The theory of hybrid automata, LICS (1996), the thermostat; here with a "
        "sensor that lags",
        {
            "room": _linear([[-0.2, -0.2], [0, 0]], [[0.2]], [[1, 0]], x0=[-0.5, 1.0]),
            "sensor": _linear([[-2.0]], [[2.0]], [[1.0]], x0=[-0.5]),
            "relay": ("relay", {**limits, "x0": 2.0}),
        },
        ("room.y1 -> sensor.u1", "sensor.y1 -> relay.u", "relay.y -> room.u1"),
        ("room.y1", "sensor.y1", "relay.y"),
        20.0,
        (0.1, 0.05, 0.02, 0.01),
        Switched(
            lambda t, z, r: (0.2 * (r - 1.0 - z[0]), 2.0 * (z[0] - z[1])),
            lambda z: float(z[1]),
            lambda z, r: (*z, r),
            (-0.5, -0.5),
            **limits,
            r=2.0,
        ),
    )


def _predator_prey() -> Problem:
    return Problem(
        "predator_prey",
        "predator and prey",
        "V. Volterra, Fluctuations in the abundance of a species considered mathematically, "
        "Nature 118 (1926) 558",
        {
            "prey": ("species", {"a": 1.0, "b": -0.5, "x0": 4.0}),
            "predator": ("species", {"a": -1.0, "b": 0.5, "x0": 1.0}),
        },
        ("prey.y -> predator.u", "predator.y -> prey.u"),
        ("prey.y", "predator.y"),
        15.0,
        (0.1, 0.05, 0.02, 0.01),
        Smooth(
            lambda t, z: (z[0] * (1.0 - 0.5 * z[1]), z[1] * (-1.0 + 0.5 * z[0])), tuple, (4.0, 1.0)
        ),
        known=False,
    )


def _brusselator() -> Problem:
    return Problem(
        "brusselator",
        "Brusselator",
        "I. Prigogine, R. Lefever, Symmetry breaking instabilities in dissipative systems II, "
        "J. Chem. Phys. 48 (1968) 1695",
        {
            "x": ("activator", {"a": 1.0, "b": 3.0, "x0": 1.5}),
            "y": ("inhibitor", {"b": 3.0, "x0": 3.0}),
        },
        ("x.y -> y.u", "y.y -> x.u"),
        ("x.y", "y.y"),
        15.0,
        (0.05, 0.02, 0.01, 0.005),
        Smooth(
            lambda t, z: (
                1.0 + z[0] ** 2 * z[1] - 4.0 * z[0],
                3.0 * z[0] - z[0] ** 2 * z[1],
            ),
            tuple,
            (1.5, 3.0),
        ),
        known=False,
    )


def _phases() -> Problem:
    """Three phases that lock on to each other."""
    w, k, z0 = (1.0, 1.3, 0.8), 0.5, (0.0, 2.0, 4.0)

    def f(t: float, z: Floats) -> list[float]:
        return [w[i] + k * sum(math.sin(z[j] - z[i]) for j in range(3) if j != i) for i in range(3)]

    return Problem(
        "phases",
        "three phases",
        "Y. Kuramoto, Chemical Oscillations, Waves, and Turbulence (1984)",
        {f"p{i}": ("phase", {"w": w[i], "k": k, "x0": z0[i]}) for i in range(3)},
        (
            "p1.y -> p0.u1",
            "p2.y -> p0.u2",
            "p0.y -> p1.u1",
            "p2.y -> p1.u2",
            "p0.y -> p2.u1",
            "p1.y -> p2.u2",
        ),
        ("p0.y", "p1.y", "p2.y"),
        15.0,
        (0.2, 0.1, 0.05, 0.02),
        Smooth(f, tuple, z0),
        known=False,
    )


def _pendulum() -> Problem:
    """A pendulum brought to 1 rad by a controller with integral action."""
    # i' = 1 - x, u = i' 6 + 4 i - 2 x'; the 1 is a state that rests.
    controller = _linear([[0, 1], [0, 0]], [[-1, 0]], [[4, 6]], [[-6, -2]], [0.0, 1.0])
    return Problem(
        "pendulum",
        "pendulum and controller",
        "H. K. Khalil, Nonlinear Systems, 3rd ed. (2002), section 12.4: integral control",
        {"plant": ("pendulum", {"g": 9.81, "d": 0.5, "x0[1]": -0.5}), "controller": controller},
        ("plant.y1 -> controller.u1", "plant.y2 -> controller.u2", "controller.y1 -> plant.u"),
        ("plant.y1", "plant.y2", "controller.y1"),
        8.0,
        (0.05, 0.02, 0.01, 0.005),
        Smooth(
            lambda t, z: (
                z[1],
                -9.81 * math.sin(z[0]) - 0.5 * z[1] + 4.0 * z[2] + 6.0 * (1.0 - z[0]) - 2.0 * z[1],
                1.0 - z[0],
            ),
            lambda z: (z[0], z[1], 4.0 * z[2] + 6.0 * (1.0 - z[0]) - 2.0 * z[1]),
            (-0.5, 0.0, 0.0),
        ),
        known=False,
    )


def _nerve() -> Problem:
    """The membrane's potential against its slow recovery."""
    return Problem(
        "nerve",
        "nerve",
        "R. FitzHugh, Impulses and physiological states in theoretical models of nerve membrane, "
        "Biophys. J. 1 (1961) 445",
        {
            "membrane": ("membrane", {"i": 0.5, "x0": -1.0}),
            # w' = 0.08 (v + 0.7 - 0.8 w); the 0.7 is a state that rests.
            "recovery": _linear([[-0.064, 0.08], [0, 0]], [[0.08]], [[1, 0]], x0=[1.0, 0.7]),
        },
        ("membrane.y -> recovery.u1", "recovery.y1 -> membrane.u"),
        ("membrane.y", "recovery.y1"),
        60.0,
        (0.5, 0.2, 0.1, 0.05),
        Smooth(
            lambda t, z: (
                z[0] - z[0] ** 3 / 3.0 - z[1] + 0.5,
                0.08 * (z[0] + 0.7 - 0.8 * z[1]),
            ),
            tuple,
            (-1.0, 1.0),
        ),
        known=False,
    )


def _duffing() -> Problem:
    """A mass on a hardening spring, without a state, driven by an oscillation."""
    return Problem(
        "duffing",
        "driven mass on a hardening spring",
        "G. Duffing, Erzwungene Schwingungen bei veränderlicher Eigenfrequenz (1918)",
        {
            "source": _linear([[0, 1.2], [-1.2, 0]], C=[[0.5, 0]], x0=[0.0, 1.0]),
            # v' = u1 + u2 - 0.2 v
            "mass": _linear([[0, 1], [0, -0.2]], [[0, 0], [1, 1]], [[1, 0]], x0=[1.0, 0.0]),
            "spring": ("hardening", {"k": 1.0, "b": 1.0}),
        },
        ("source.y1 -> mass.u2", "mass.y1 -> spring.u", "spring.y -> mass.u1"),
        ("mass.y1", "spring.y"),
        15.0,
        (0.1, 0.05, 0.02, 0.01),
        Smooth(
            lambda t, z: (
                z[1],
                0.5 * math.sin(1.2 * t) - 0.2 * z[1] - z[0] - z[0] ** 3,
            ),
            lambda z: (z[0], -z[0] - z[0] ** 3),
            (1.0, 0.0),
        ),
        known=False,
    )


def _tanks() -> Problem:
    """Two tanks in a row, filled by a pump whose controller keeps the second one's level at 1."""
    return Problem(
        "tanks",
        "two tanks and a controller",
        "K. H. Johansson, The quadruple-tank process, IEEE Trans. Control Syst. Technol. 8 (2000) "
        "456; here one row of it",
        {
            "first": ("tank", {"c": 1.0, "A": 2.0, "x0": 0.3}),
            "second": ("tank", {"c": 1.0, "A": 1.0, "x0": 0.3}),
            # i' = 1 - x, u = 0.2 i + 0.8 (1 - x)
            "controller": _linear([[0, 1], [0, 0]], [[-1]], [[0.2, 0.8]], [[-0.8]], [2.5, 1.0]),
        },
        ("controller.y1 -> first.u", "first.y1 -> second.u", "second.y2 -> controller.u1"),
        ("first.y2", "second.y2", "controller.y1"),
        20.0,
        (0.2, 0.1, 0.05, 0.02),
        Smooth(
            lambda t, z: (
                (0.2 * z[2] + 0.8 * (1.0 - z[1]) - math.sqrt(z[0])) / 2.0,
                math.sqrt(z[0]) - math.sqrt(z[1]),
                1.0 - z[1],
            ),
            lambda z: (z[0], z[1], 0.2 * z[2] + 0.8 * (1.0 - z[1])),
            (0.3, 0.3, 2.5),
        ),
        known=False,
    )


def _drive() -> Problem:
    """A motor, its current controller and the speed controller above it, brought to speed 1."""
    return Problem(
        "drive",
        "drive with two controllers",
        "W. Leonhard, Control of Electrical Drives, 3rd ed. (2001), chapter 7",
        {
            # (i, w): 0.01 i' = u - i - 0.5 w, 0.05 w' = 0.5 i - 0.02 w
            "motor": _linear([[-100, -50], [10, -0.4]], [[100], [0]], [[1, 0], [0, 1]]),
            # e = r - i: x' = e, u = 100 x + 2 e
            "current": _linear([[0]], [[1, -1]], [[100]], [[2, -2]]),
            # e = 1 - w: x' = e, r = 4 x + 2 e
            "speed": _linear([[0, 1], [0, 0]], [[-1]], [[4, 2]], [[-2]], [0.0, 1.0]),
        },
        (
            "motor.y1 -> current.u2",
            "motor.y2 -> speed.u1",
            "speed.y1 -> current.u1",
            "current.y1 -> motor.u1",
        ),
        ("motor.y1", "motor.y2", "current.y1", "speed.y1"),
        2.0,
        (5e-3, 2e-3, 1e-3, 5e-4),
        Linear(),
        known=False,
    )


def _ladder() -> Problem:
    """Three cells of a line of resistors and capacitors; the neighbours exchange voltages."""

    def cell(x0: float) -> tuple[str, Start]:
        return _linear([[-2.0]], [[1.0, 1.0]], [[1.0]], x0=[x0])

    return Problem(
        "ladder",
        "line of resistors and capacitors",
        "E. Lelarasmee, A. E. Ruehli, A. L. Sangiovanni-Vincentelli, The waveform relaxation "
        "method for time-domain analysis of large scale integrated circuits, IEEE Trans. CAD 1 "
        "(1982) 131",
        {"first": cell(1.0), "second": cell(0.0), "third": cell(0.0)},
        (
            "first.y1 -> second.u1",
            "second.y1 -> first.u2",
            "second.y1 -> third.u1",
            "third.y1 -> second.u2",
        ),
        ("first.y1", "second.y1", "third.y1"),
        8.0,
        (0.2, 0.1, 0.05, 0.02),
        Linear(),
        known=False,
    )


PROBLEMS: tuple[Problem, ...] = (
    _two_masses("plain", "places and speeds exchanged"),
    _two_masses("force", "force against place and speed", force=True),
    _two_masses("heavy", "one ten times as heavy", m=(1.0, 10.0), force=True),
    _two_masses(
        "stiff",
        "stiffly coupled",
        k=200.0,
        b=2.0,
        force=True,
        steps=(0.02, 0.01, 0.005, 0.002),
    ),
    _two_masses("undamped", "without damping", d=(0.0, 0.0), b=0.0),
    _added_mass(0.4),
    _quarter_car(),
    _van_der_pol(1.0, 15.0, (0.05, 0.02, 0.01, 0.005)),
    _van_der_pol(5.0, 20.0, (0.02, 0.01, 0.005, 0.002)),
    _chain(),
    _algebraic_loop(0.3),
    _algebraic_loop(0.7),
    _algebraic_loop(0.95),
    _algebraic_loop(1.05),
    _lorenz(),
    _relay(),
    _oscillator(),
    _spring_damper(),
    _stiff_loop(),
    _thermostat(),
    _predator_prey(),
    _brusselator(),
    _phases(),
    _pendulum(),
    _nerve(),
    _duffing(),
    _tanks(),
    _drive(),
    _ladder(),
)


def problem(name: str) -> Problem:
    """The problem of a name."""
    return next(found for found in PROBLEMS if found.name == name)
