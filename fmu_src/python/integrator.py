"""Step-size control around one written-out Runge-Kutta step.

E. Hairer, S. P. Norsett and G. Wanner, Solving Ordinary Differential Equations I, 2nd ed.,
section II.4 (automatic step size control).
"""

from __future__ import annotations

__all__ = ["StepFailure", "integrate"]

# Hairer, Norsett, Wanner (4.13): a safety factor, and bounds on the change of the step.
SAFETY = 0.9
SMALLEST_CHANGE = 0.2
LARGEST_CHANGE = 5.0
ORDER = 5
INFINITY = float("inf")
# A macro step that needs more internal steps than this is refused: the loop has diverged or its
# rates are too fast for an explicit method.
MOST_STEPS = 100_000


class StepFailure(ArithmeticError):
    """The states cannot be integrated over the step; the text says why and what to do."""


def integrate(step, k, t, start, end, x, v, theta, h, tolerance):
    """Integrate the states from s = start to s = end, s being the time since t.

    Parameters
    ----------
    step : callable
        One Runge-Kutta step, of the FMU's generated equations.
    k : tuple of float
        Rates at start.
    t, start, end : float
        Communication point, and the part of the macro step to integrate over.
    x : tuple of float
        States at start.
    v : tuple of tuple
        Cubic coefficients of each input over the macro step.
    theta : callable or None
        theta(t), smooth over [t + start, t + end].
    h : float
        First step to try.
    tolerance : float
        Relative tolerance; the absolute one is a thousandth of it.

    Returns
    -------
    x : tuple of float
        States at end.
    h : float
        The step to try next time.

    Raises
    ------
    StepFailure
        If a value is not finite, or the step becomes too small.
    """
    absolute = 1e-3 * tolerance
    s = start
    for _ in range(MOST_STEPS):
        last = s + h >= end
        tried = end - s if last else h
        y, g, error = step(t, s, tried, x, k, v, theta, absolute, tolerance)
        # max() can drop a NaN, so the states are looked at too: only a finite sum less itself is 0.
        total = sum(y)
        if error <= 1.0 and total - total == 0.0:
            change = SAFETY * error ** (-1.0 / ORDER) if error > 0.0 else LARGEST_CHANGE
            proposed = tried * min(LARGEST_CHANGE, max(SMALLEST_CHANGE, change))
            if last:
                # A step cut off by the end says nothing against the longer one tried before.
                return y, max(h, proposed) if tried < h else proposed
            x, k, s, h = y, g, s + tried, proposed
        else:
            change = SAFETY * error ** (-1.0 / ORDER) if 1.0 < error < INFINITY else SMALLEST_CHANGE
            h = tried * max(SMALLEST_CHANGE, change)
            if s + h <= s or h < 1e-13 * max(abs(t), 1e-3):
                raise StepFailure(
                    "the states leave the range of floating-point numbers at t = %.9g; "
                    "the loop diverges: take a smaller communication step" % (t + s)
                )
    raise StepFailure(
        f"{MOST_STEPS} internal steps did not reach the end of the step from t = {t:.9g}; "
        "take a smaller communication step"
    )
