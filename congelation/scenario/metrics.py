"""Numbers that sum up a trajectory: v(t) in, one number out.

A metric is a function of the time (N,) and of the values (N, M) of a group of variables; |v|
below is the Euclidean norm over the group. What is integrated follows a monotone piecewise cubic
between the points (Fritsch and Butland 1984), which is accurate where steps are long and does not
overshoot where signals jump; crossings are interpolated linearly; extrema are those of the points.

Further metrics come from installed packages: an entry point of the group ``congelation.metrics``
names a `Metric`.

References
----------
C. A. Desoer and M. Vidyasagar, Feedback Systems: Input-Output Properties, Academic Press 1975.
F. N. Fritsch and J. Butland, A method for constructing local monotone piecewise cubic
interpolants, SIAM J. Sci. Stat. Comput. 5, 1984.
D. Graham and R. C. Lathrop, The synthesis of "optimum" transient response: criteria and standard
forms, Trans. AIEE 72(II), 1953.
K. J. Åström and R. M. Murray, Feedback Systems, Princeton University Press 2008.
P. A. Ioannou and J. Sun, Robust Adaptive Control, Prentice Hall 1996.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points

import numpy as np
import numpy.typing as npt

from congelation.errors import InvalidInput, nearest

__all__ = ["ENTRY_POINTS", "METRICS", "Metric", "metric", "norm"]

Array = npt.NDArray[np.float64]

ENTRY_POINTS = "congelation.metrics"


@dataclass(frozen=True)
class Metric:
    """A named number of a trajectory.

    Parameters
    ----------
    name : str
        What a scenario calls it.
    evaluate : callable
        ``evaluate(time, values, **options) -> float or None`` with `time` (N,), `values` (N, M)
        and real-valued keyword-only options; those without a default must be given. None, or nan,
        is no answer: the run's column is empty. None: the function is not in this room; those of
        the loop are in `congelation.verify.measure`.
    definition : str
        One line: the formula and its source.
    unit : callable
        Maps the unit of the variables to that of the metric.
    scalar : bool
        True if the metric is of one variable, not of a group.
    loop : bool
        True if the metric is of the closed loop as a whole: a scenario gives no `of`, and it is
        ``evaluate(case, time, columns, values)``, the states of the loop among the columns.
    recorded : bool
        True if such a metric is of every variable that the experiment records.
    integral : bool
        True if it is an integral over time, which needs points as close as the signal turns.
    positive : tuple of str
        Those of the options that have to be positive.
    times, values : tuple of str
        Those that are times, in seconds, and those that are in the unit of the variables: a
        scenario may state a unit of them.
    """

    name: str
    evaluate: Callable[..., float | None] | None
    definition: str
    unit: Callable[[str], str]
    scalar: bool = False
    loop: bool = False
    recorded: bool = False
    integral: bool = False
    positive: tuple[str, ...] = ()
    times: tuple[str, ...] = ()
    values: tuple[str, ...] = ()

    @property
    def options(self) -> dict[str, bool]:
        """Names of the options; True marks those that must be given."""
        if self.evaluate is None:
            return {}
        parameters = inspect.signature(self.evaluate).parameters.values()
        return {
            p.name: p.default is inspect.Parameter.empty
            for p in parameters
            if p.kind is inspect.Parameter.KEYWORD_ONLY
        }

    @property
    def function(self) -> Callable[..., float | None]:
        """`evaluate`, where it is there."""
        if self.evaluate is None:
            raise InvalidInput(f"metric '{self.name}' is only declared; give it a function")
        return self.evaluate

    def check_size(self, variables: int) -> None:
        """Raise InvalidInput unless the metric can be of that many variables."""
        if self.scalar and variables != 1:
            raise InvalidInput(f"{self.name} is of one variable, not of a group of {variables}")


def norm(values: Array) -> Array:
    """|v| at each row: the Euclidean norm over the columns of `values` (N, M), shape (N,)."""
    if values.shape[1] == 1:
        return np.abs(values[:, 0])
    # It does not overflow where squares do, as of control values past 1e154.
    found: Array = np.hypot.reduce(values, axis=1)
    return found


def peak(time: Array, values: Array, *, after: float = -math.inf) -> float | None:
    """max |v(t)|, the L_infinity norm, from `after` (s) on; None where nothing is left."""
    left = values if after == -math.inf else values[np.searchsorted(time, after) :]
    return float(np.max(norm(left))) if len(left) else None


def settling_time(time: Array, values: Array, *, below: float) -> float:
    """Time from the start until |v| is at most `below` for good; inf if it never is."""
    size = norm(values)
    outside = np.flatnonzero(size > below)
    if outside.size == 0:
        return 0.0
    last = int(outside[-1])
    if last == len(time) - 1:
        return math.inf
    fraction = (size[last] - below) / (size[last] - size[last + 1])
    crossing = time[last] + fraction * (time[last + 1] - time[last])
    return float(crossing - time[0])


def _integral(time: Array, integrand: Array) -> float:
    """Of the monotone piecewise cubic through the points.

    The slopes, and so the number to rounding, are those of scipy's PchipInterpolator, whose import
    takes a quarter of a second, and a call ten times as long as this one.
    """
    if not np.isfinite(integrand).all():
        return math.inf
    if len(time) < 2:
        return 0.0
    h = time[1:] - time[:-1]  # np.diff takes longer than the differences of a short run
    secants = (integrand[1:] - integrand[:-1]) / h
    if len(h) == 1:
        slopes = np.repeat(secants, 2)
    else:
        # Zero where the data turn, else the harmonic mean of the secants on both sides, weighted
        # by w = 2 h_k + h_(k-1) and h_k + 2 h_(k-1).
        left, right = secants[:-1], secants[1:]
        w_left, w_right = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
        turns = np.sign(left) * np.sign(right) <= 0.0
        slopes = np.empty(len(time))
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes[1:-1] = (w_left + w_right) / (w_left / left + w_right / right)
        slopes[1:-1][turns] = 0.0
        slopes[0] = _slope_at_end(*h[:2].tolist(), *secants[:2].tolist())
        slopes[-1] = _slope_at_end(*h[:-3:-1].tolist(), *secants[:-3:-1].tolist())
    ends = h / 2.0 * (integrand[:-1] + integrand[1:])
    return float(np.sum(ends + h * h / 12.0 * (slopes[:-1] - slopes[1:])))


def _slope_at_end(h: float, h_next: float, secant: float, secant_next: float) -> float:
    """The slope of the parabola through the outer three points, limited to stay monotone."""
    slope = ((2.0 * h + h_next) * secant - h * secant_next) / (h + h_next)
    if _sign(slope) != _sign(secant):
        return 0.0
    if _sign(secant) != _sign(secant_next) and abs(slope) > 3.0 * abs(secant):
        return 3.0 * secant
    return slope


def _sign(value: float) -> int:
    return (value > 0.0) - (value < 0.0)


def integral_of_square(time: Array, values: Array) -> float:
    """Integral of |v|^2 dt, the square of the L_2 norm."""
    return _integral(time, norm(values) ** 2)


def integral_of_absolute(time: Array, values: Array) -> float:
    """Integral of |v| dt, the L_1 norm."""
    return _integral(time, norm(values))


def integral_of_time_absolute(time: Array, values: Array) -> float:
    """Integral of t |v| dt, t counted from the start."""
    return _integral(time, (time - time[0]) * norm(values))


def overshoot(time: Array, values: Array, *, reference: float = 0.0) -> float | None:
    """Largest excursion past `reference`, as a fraction of the deviation at the start.

    None where there is no deviation at the start.
    """
    deviation = values[:, 0] - reference
    if deviation[0] == 0.0:
        return None
    return float(max(0.0, np.max(-deviation / deviation[0])))


def drift(time: Array, values: Array) -> float:
    """|v(t_end) - v(t_start)|."""
    return float(norm(values[-1:] - values[:1])[0])


def _same(unit: str) -> str:
    return unit


def _time(unit: str) -> str:
    return "s"


def _ratio(unit: str) -> str:
    return ""


def _times(suffix: str, power: str = "") -> Callable[[str], str]:
    def unit_of(unit: str) -> str:
        if not unit:
            return suffix
        return f"{unit if unit.isalpha() else f'({unit})'}{power} {suffix}"

    return unit_of


_BUILT_IN = (
    Metric(
        "peak",
        peak,
        "max_t |v(t)| for t >= after, the L_inf norm (Desoer and Vidyasagar 1975, ch. II)",
        _same,
        times=("after",),
    ),
    Metric(
        "settling_time",
        settling_time,
        "inf {T >= 0 : |v(t)| <= below for all t >= T} (Astrom and Murray 2008, sec. 5.3)",
        _time,
        positive=("below",),
        values=("below",),
    ),
    Metric(
        "overshoot",
        overshoot,
        "max_t (reference - v(t)) / (v(0) - reference), 0 if negative, empty if v(0) = reference"
        " (Astrom and Murray 2008, sec. 5.3)",
        _ratio,
        scalar=True,
        values=("reference",),
    ),
    Metric(
        "integral_of_square",
        integral_of_square,
        "int |v|^2 dt, the square of the L_2 norm (Desoer and Vidyasagar 1975, ch. II)",
        _times("s", "^2"),
        integral=True,
    ),
    Metric(
        "ise",
        integral_of_square,
        "int |v|^2 dt, integral of squared error (Graham and Lathrop 1953)",
        _times("s", "^2"),
        integral=True,
    ),
    Metric(
        "iae",
        integral_of_absolute,
        "int |v| dt, integral of absolute error (Graham and Lathrop 1953)",
        _times("s"),
        integral=True,
    ),
    Metric(
        "itae",
        integral_of_time_absolute,
        "int t |v| dt, integral of time times absolute error (Graham and Lathrop 1953)",
        _times("s^2"),
        integral=True,
    ),
    Metric(
        "drift",
        drift,
        "|v(t_end) - v(t_start)|; of an estimate: its parameter drift (Ioannou and Sun 1996,"
        " sec. 8.3.1)",
        _same,
    ),
    Metric(
        "lyapunov",
        None,
        "max_t of (worst V' over the admitted theta + claimed rate) / (sum of |terms|), ell at the"
        " centre of theta's box; above 1e-9 the certificate fails (Chen and Astolfi 2018)",
        _ratio,
        loop=True,
    ),
    Metric(
        "lyapunov_share",
        None,
        "(V(T) + int claimed rate dt) / (V(0) + int residue dt), at most 1 where the certificate"
        " holds: of tracking, leakage and disturbances the bound of the mean error against the run",
        _ratio,
        loop=True,
    ),
    Metric(
        "ultimate_bound",
        None,
        "b/a, b the largest residue of the run and a V the least claimed rate: what V ends below;"
        " empty without leakage, where a = 0 (Ioannou and Sun 1996, sec. 8.4.1)",
        _ratio,
        loop=True,
    ),
    Metric(
        "ultimate_share",
        None,
        "max_t V(t) / (exp(-a t) V(0) + (1 - exp(-a t)) b/a), at most 1 where the certificate"
        " holds; empty where a = 0 (Ioannou and Sun 1996, sec. 8.4.1)",
        _ratio,
        loop=True,
    ),
    Metric(
        "deviation",
        None,
        "max over time and recorded variables of |co-simulated - monolithic| / peak, the latter by"
        " DOP853 (Hairer, Norsett and Wanner 1993): the error of the coupling",
        _ratio,
        loop=True,
        recorded=True,
    ),
)

METRICS: Mapping[str, Metric] = {entry.name: entry for entry in _BUILT_IN}


def metric(name: str) -> Metric:
    """The metric called `name`: one of `METRICS`, or one that an installed package offers.

    Raises
    ------
    InvalidInput
        If there is none, or if the entry point of that name is not a `Metric`.
    """
    if name in METRICS:
        return METRICS[name]
    offered = {point.name: point for point in entry_points(group=ENTRY_POINTS)}
    if name not in offered:
        raise InvalidInput(f"'{name}' is no metric; {nearest(name, [*METRICS, *offered])}")
    try:
        found = offered[name].load()
    except (ImportError, AttributeError) as error:
        raise InvalidInput(f"metric '{name}' cannot be loaded: {error}") from error
    if not isinstance(found, Metric):
        raise InvalidInput(f"metric '{name}' is {offered[name].value}, which is not a Metric")
    return found
