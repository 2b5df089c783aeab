"""The oscillator with its controller as one differential equation, solved without any FMU."""

import itertools

import numpy as np
from scipy.integrate import solve_ivp

W, DAMPING, HALF_PERIOD = 1.5, 0.2, 0.65


def solution(times, a=0.0, k=2.0, d=1.0, c=0.3, x0=(1.0, 0.5)):
    """(x1, x2, q) at increasing times, shape (N, 3); the force +-a jumps every half period."""
    times = np.asarray(times, dtype=float)
    rows, z = [], np.array([*x0, 0.0])
    jumps = [number * HALF_PERIOD for number in range(int(times[-1] / HALF_PERIOD) + 2)]
    for number, (start, end) in enumerate(itertools.pairwise(jumps)):
        force = a if number % 2 == 0 else -a
        inside = times[(times >= start) & (times < end)]

        def rates(t, z, force=force):
            x1, x2, q = z
            u = -k * x1 - d * x2 - 0.5 * q - c * x1**3
            return [x2, -(W**2) * x1 - DAMPING * x2 + u + force, x1]

        step = solve_ivp(
            rates,
            (start, end),
            z,
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
            t_eval=[*inside, end],
        )
        rows.extend(step.y.T[:-1])
        z = step.y[:, -1]
    return np.array(rows)


def order(steps, errors):
    """Exponent of the power law through (step, error), by least squares."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])
