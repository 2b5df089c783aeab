"""Step control: the error of a step by halving it, and the length of the next one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling import AdaptiveStepper, Trial
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import settle_discrete

__all__ = [
    "DECIDED",
    "SMALLEST_ERROR",
    "Halving",
    "Pace",
    "StepSize",
    "compared",
    "halved",
    "is_floor",
]

Floats = npt.NDArray[np.float64]

ORDER_HELD = 2
"""Order of the couplings that hold inputs at their mean; the error of one step falls with one power
more."""

ORDER_PASSING = 1
"""The power of the step with which an error falls that passes with it."""

SHARES = 2.0
"""Errors of steps are in part opposite, so their sum may be allowed so many tolerances."""

LEAST_SHARE = 1e-2
"""The lasting error that any step may have, as a share of the tolerance: where a solution is not
smooth, as after a blow, steps are few and tiny, and their shares would be out of reach."""

PASSING_SHARE = 0.3
"""The error that a step may have where it does not last, as a share of the tolerance."""

LEAST_SHARE_UNSEEN, PASSING_SHARE_UNSEEN = 0.2, 1.2
"""The same for recorded values that no input sees: nothing goes on from them, and the part of their
error that grows with the square of a step cannot be told from one that lasts. The acceleration of a
quarter truck under stated couplings took ten times the steps of its links, to be right to 0.4
tolerances in place of 2.5."""

PROBED = 8
"""Accepted steps from one look at how much of the error lasts to the next: it costs two passes."""

SHORTEST_JUDGED = 1e-6
"""Steps up to this part of the horizon are judged by the links alone: a recorded value that no
input sees may be as rough as it likes."""

FLOOR_EXPONENT = 0.25
"""An error that falls by less than this power of the step does not come from the step."""

MOST_OF_REFUSED = 0.5
"""A step that is compared with a longer one is no longer than this part of it."""


@dataclass
class Halving:
    """What is remembered of steps that were made whole and in halves.

    Parameters
    ----------
    sizes : array, shape (W,)
        The largest that each judged value has been so far: those of the links, then what is
        recorded besides.
    lasting : array, shape (W,)
        The part of the difference of whole and halves that lasts, when it was looked at last.
    left : int
        Accepted steps until it is looked at again.
    found : float
        Error of the last step tried, the largest of all links, relative to nominal value plus size.
    estimate : float
        The same over the share of the tolerance that a step may have, for a result to state. A
        value that no input sees may have more, and more is stated.
    jump, kink : float
        How far a link was off, relative to the same, that jumped somewhere in the step, or whose
        slope jumped at its start; see `jump_within`.
    """

    sizes: Floats
    lasting: Floats
    left: int
    found: float = 0.0
    estimate: float = 0.0
    jump: float = 0.0
    kink: float = 0.0

    def judge(
        self, relative: Floats, links: int, length: float, horizon: float
    ) -> tuple[float, int, int]:
        """Weigh the errors of a step, relative to nominal value plus size, shape (W,): those of
        the links, then those of recorded values besides. Step and horizon are in seconds.

        Returns
        -------
        tuple
            The largest over the share of the tolerance that it may have, the power of the step
            that it falls with, and its place.
        """
        seen = np.arange(len(relative)) < links
        if length <= SHORTEST_JUDGED * horizon:
            relative = np.where(seen, relative, 0.0)
        even, least = SHARES * length / horizon, np.where(seen, LEAST_SHARE, LEAST_SHARE_UNSEEN)
        lasting = relative * self.lasting / np.maximum(even, least)
        passing = relative / np.where(seen, PASSING_SHARE, PASSING_SHARE_UNSEEN)
        allowed = np.maximum(lasting, passing)
        worst = int(allowed.argmax())
        self.found = float(relative.max())
        self.estimate = float(np.maximum(lasting, relative / PASSING_SHARE).max())
        order = ORDER_HELD + 1 if even < least[worst] else ORDER_HELD
        if passing[worst] >= lasting[worst]:
            order = ORDER_PASSING
        return float(allowed[worst]), order, worst

    def accepted(self, values: Floats) -> Halving:
        """After a step that ends with these judged values, shape (W,)."""
        left = PROBED if self.left == 0 else self.left - 1
        return Halving(np.maximum(self.sizes, np.abs(values)), self.lasting, left)


def halved(
    ensemble: Ensemble,
    horizon: float,
    stepper: AdaptiveStepper[Any],
    state: Any,
    time: float,
    end: float,
    halving: Halving,
) -> Trial[Any]:
    """A step made whole, and again in two halves, which are kept; the difference is its error.

    With an error of c h^3 for a step of h, the halves are off by a quarter of that together, and
    differ from the whole by three times as much (Hairer, Norsett, Wanner, Solving Ordinary
    Differential Equations I, section II.4). It sees whatever the FMUs make of held inputs, from the
    first step on.

    Such errors last, and add up where nothing damps them: that of a step may be the share of the
    tolerance that the step is of the horizon, or a small one if that is larger. Another part of the
    difference is in proportion to h and passes with the step: outputs that an FMU has computed with
    the held input rather than with its value at the end. The first half once more in halves tells
    the two apart.

    Judged are the links, and recorded outputs of components with inputs, which no other input may
    see: a component at the end of a chain makes something of its held inputs, too.

    Returns
    -------
    Trial
        Its error is relative to nominal value plus size, and over the share of the tolerance that
        it may have.
    """
    middle = time + (end - time) / 2.0

    def made(state: Any, start: float, stop: float) -> Trial[Any]:
        trial = stepper.attempt(state, start, stop)
        ensemble.check(stop)
        return trial

    def in_halves(state: Any, start: float, stop: float) -> tuple[Trial[Any], Floats]:
        """The last trial of two, and the links' values after the first."""
        between = start + (stop - start) / 2.0
        first = made(state, start, between)
        values = ensemble.Y[ensemble.judged]
        if not math.isfinite(first.error):
            return first, values
        settle_discrete(ensemble, between)
        ensemble.level = 1
        try:
            ensemble.save()
            return made(first.state, between, stop), values
        finally:
            ensemble.level = 0

    whole = made(state, time, end)
    at_end = ensemble.Y[ensemble.judged]
    if not math.isfinite(whole.error):
        return whole
    at_middle = None
    if halving.left == 0:
        ensemble.restore()
        quarters, _ = in_halves(state, time, middle)
        if math.isfinite(quarters.error):
            at_middle = ensemble.Y[ensemble.judged]
    ensemble.restore()
    rest, first_half = in_halves(state, time, end)
    if not at_end.size or not math.isfinite(rest.error):
        return rest
    found = ensemble.Y[ensemble.judged]
    difference = found - at_end
    if at_middle is not None:
        # a h + b h^3 over the step, a h/2 + b h^3/8 over its half.
        lasting = np.abs(difference - 2.0 * (at_middle - first_half)) * (4.0 / 3.0)
        size = np.abs(difference)
        halving.lasting = np.divide(lasting, size, out=np.ones(len(size)), where=size > lasting)
    scale = ensemble.judged_nominal + np.maximum(halving.sizes, np.abs(found))
    relative = np.abs(difference) / (2.0**ORDER_HELD - 1.0) / scale
    links = len(ensemble.links)
    halving.jump, halving.kink = jump_within(
        stepper.points(state).now, first_half[:links], found[:links], scale[:links], end - time
    )
    return Trial(rest.state, *halving.judge(relative, len(ensemble.links), end - time, horizon))


SUDDEN = 8.0, 1.4
"""How many times as far off a link is at the end of a step as in its middle, above or below which
it has jumped in one half."""

IN_PROPORTION = 1.6, 2.5
"""And between which its slope has jumped at the start; curvature makes 4, rounding errors 1."""


def jump_within(
    now: Floats, middle: Floats, end: Floats, scale: Floats, length: float
) -> tuple[float, float]:
    """How far a link is off from where its value and derivative `now`, shape (2, L), lead, if all
    of that comes in one half of the step, or from its start on; the largest relative to `scale`.

    Parameters
    ----------
    middle, end, scale : arrays, shape (L,)
    length : float
        Seconds.

    Returns
    -------
    jump, kink : float
        The largest of the two kinds.
    """
    value, slope = now
    off = np.abs(end - value - length * slope)
    half = np.abs(middle - value - (length / 2.0) * slope)
    many, few = SUDDEN
    sudden = (off > many * half) | (off < few * half)
    relative = off / scale
    kinked = in_proportion(half, off)
    return float(relative[sudden].max(initial=0.0)), float(relative[kinked].max(initial=0.0))


def in_proportion(half: Any, whole: Any) -> Any:
    """Whether numbers are in proportion to the length of a step, to the half and to the whole."""
    few, many = IN_PROPORTION
    return (few * half < whole) & (whole < many * half)


def compared(
    refused: tuple[float, float] | None, length: float, error: float
) -> tuple[float, float]:
    """Length and error of the refused step with which shorter ones are compared, once another has
    been refused: the longer one until the lengths differ enough."""
    if refused is None or length <= MOST_OF_REFUSED * refused[0]:
        return length, error
    return refused


def is_floor(refused: tuple[float, float], length: float, error: float, tolerance: float) -> bool:
    """Whether a shorter step than the one refused, (length, error), has hardly less of an error,
    and one that the run can bear."""
    ratio = length / refused[0]
    return (
        error <= PASSING_SHARE * tolerance
        and ratio <= MOST_OF_REFUSED
        and error > refused[1] * ratio**FLOOR_EXPONENT
    )


EVENNESS = 2
"""The power of its length over the mean with which the error of a long step counts more."""

MOST_UNEVEN = 16.0
"""And it counts at most so many times, as does that of a short step less."""

DECIDED = 0.1
"""Error, in tolerances, from which on it was the prediction that decided the length of a step."""

LAG = 2.5
"""The largest lag of a step, in means of those of the decided ones."""

REMEMBERED = 20.0
"""For so many times as long as there were decided steps, their lag bounds that of all steps; from
then on, steps may grow with the time since: a short blow at the start must not rule a long run."""


@dataclass(frozen=True)
class Pace:
    """What the steps so far say of the next one, where inputs are predicted.

    How far inputs were off at the end of a step is no measure of what that leaves behind. An FMU
    that holds its inputs integrates the error over the step, together with one in proportion to
    its own rates, which does not show. So steps are kept even in two ways:

    The error of a step is weighed by its length over the mean so far. A relaxation oscillation (Van
    der Pol, mu = 5) in 755 steps was off by 0.44 of its peak, and is by 0.05 in 814 with this
    weight (0.03 in as many equal steps).

    An input that changes evenly is predicted exactly, and still held: the FMU sees it late in one
    half of the step and early in the other, which leaves an error in proportion to the change of
    the input times the square of the length, called lag here. No step may have more than `LAG`
    times the mean lag of those whose length the prediction has decided. Three phases that lock on
    to each other, and then grow evenly, were off by 9 times the error of as many equal steps
    without this bound, and are by 2.

    Steps before the first decided one, from the tiny first one on, do not count.

    Parameters
    ----------
    sizes : array, shape (L,)
        The largest that each link has been so far.
    begun, last : float
        When the first decided step began, and the last one ended, in seconds.
    steps, decided : int
        Steps since then, and those of them whose length the prediction decided.
    lags : float
        The sum of their lags.
    """

    sizes: Floats
    begun: float = 0.0
    last: float = 0.0
    steps: int = 0
    decided: int = 0
    lags: float = 0.0

    @property
    def order(self) -> int:
        """The power of the step by which weighed errors fall faster."""
        return EVENNESS if self.decided else 0

    def judged(self, trial: Trial[Any], values: Floats, nominal: Floats) -> Trial[Any]:
        """A trial whose error is relative to nominal value plus the largest that each link has been
        so far, with the links' values at its end, shapes (L,).

        A force that has been 15 kN need not be exact to the same part of a newton whenever it
        passes zero.
        """
        if trial.missed is None or not len(values):
            return trial
        relative = trial.missed / (nominal + np.maximum(self.sizes, np.abs(values)))
        worst = int(relative.argmax())
        return trial._replace(error=float(relative[worst]), worst=worst)

    def lag(self, change: Floats, nominal: Floats, length: float) -> float:
        """Of a step over which the links changed so much, shapes (L,)."""
        return length**2 * float((np.abs(change) / (nominal + self.sizes)).max(initial=0.0))

    def weighed(self, error: float, lag: float, time: float, length: float, order: int) -> float:
        """The error, in tolerances, of a step from `time`, which falls with the power `order` of
        the step."""
        if self.decided == 0:
            return error
        weight = (length * self.steps / (time - self.begun)) ** EVENNESS
        weight = min(max(weight, 1.0 / MOST_UNEVEN), MOST_UNEVEN)
        # A lag falls with the third power.
        forgotten = (time - self.last) / (REMEMBERED * (self.last - self.begun))
        allowed = LAG * self.lags / self.decided * max(1.0, forgotten) ** 3
        return max(error * weight, (lag / allowed) ** (order / 3.0) if allowed > 0.0 else 0.0)

    def followed(
        self, error: float, lag: float, time: float, length: float, values: Floats
    ) -> Pace:
        """After a step from `time` of that error as it was predicted, to the links' values."""
        pace = replace(self, sizes=np.maximum(self.sizes, np.abs(values)))
        decides = DECIDED <= error <= 1.0
        if not (decides or self.decided):
            return pace
        pace = replace(pace, begun=self.begun if self.decided else time, steps=self.steps + 1)
        if not decides:
            return pace
        return replace(pace, last=time + length, decided=self.decided + 1, lags=self.lags + lag)


SAFETY = 0.9
LARGEST_CHANGE = 4.0
SMALLEST_CHANGE = 0.2
"""Bounds and margin as usual: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I,
section II.4."""

PROPORTIONAL, INTEGRAL = 0.4, 0.7
"""Exponents of the PI controller, to be divided by the order: K. Gustafsson, M. Lundh,
G. Soderlind, A PI stepsize control for the numerical solution of ordinary differential equations,
BIT 28 (1988); Hairer, Wanner, Solving Ordinary Differential Equations II, section IV.2."""

LARGEST_AT_START = 30.0
"""By so much the first steps grow where inputs are predicted and an error is at its floor, which
then reaches a tenth of the tolerance at most."""

SMALLEST_ERROR = 1e-4
"""Floor of the scaled error: below it the step grows by the largest change anyway."""


@dataclass(frozen=True)
class StepSize:
    """The step to try, and what the step control remembers.

    Parameters
    ----------
    length : float
        Seconds.
    error_before : float
        Scaled error (1 is the tolerance) of the last accepted step.
    rejected : bool
        Whether the last trial was rejected; the step does not grow right after.
    """

    length: float
    error_before: float = 1.0
    rejected: bool = False

    def accepted(self, error: float, length: float, order: int) -> StepSize:
        """After a step of `length` with scaled error `error` <= 1, which falls with the power
        `order` of the step."""
        error = max(error, SMALLEST_ERROR)
        change = SAFETY * error ** (-INTEGRAL / order) * self.error_before ** (PROPORTIONAL / order)
        largest = 1.0 if self.rejected else LARGEST_CHANGE
        change = min(largest, max(SMALLEST_CHANGE, change))
        return replace(self, length=length * change, error_before=error, rejected=False)

    def begun(self, error: float, length: float, order: int) -> StepSize:
        """The same until the error has decided the length of a step. The first steps are far too
        short, and each costs as much as a long one."""
        if error > SMALLEST_ERROR or self.rejected:
            return self.accepted(error, length, order)
        return replace(self, length=length * LARGEST_AT_START, error_before=SMALLEST_ERROR)

    def refused(self, error: float, length: float, order: int) -> StepSize:
        """After a step of `length` that was taken back; `error` may be infinite."""
        change = SMALLEST_CHANGE
        if math.isfinite(error):
            change = min(SAFETY, max(SMALLEST_CHANGE, SAFETY * error ** (-1.0 / order)))
        return replace(self, length=length * change, rejected=True)

    def restarted(self, length: float) -> StepSize:
        """After a jump: what was before says nothing."""
        return replace(self, length=length, error_before=1.0, rejected=False)
