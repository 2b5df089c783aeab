"""What becomes of a step that was tried, and how long the next one is."""

import math

import pytest

from congelation.cosim.adaptive_step import Outcome, Rules, Tried, outcome_of, resized
from congelation.cosim.coupling import Trial
from congelation.cosim.step_size import Pace, StepSize

TOLERANCE = 1e-3
PLAIN = Rules(
    TOLERANCE,
    horizon=10.0,
    takes_back=True,
    switches=False,
    announced=True,
    keeps=False,
    halves=False,
    predicts=False,
)


def changed(rules=PLAIN, **fields):
    return Rules(**{**vars(rules), **fields})


def tried(error, length=0.1, *, beyond=0.0, found=0.0, switched=False):
    """A step whose connections have this error, in tolerances; what is recorded may have more."""
    trial = Trial(None, error * TOLERANCE, 3, 0)
    fits = error <= 1.0
    return Tried(
        5.0, length, trial, max(error, beyond), 3, fits, found, error, 0.0, switched=switched
    )


NOT_MADE = Tried(5.0, 0.1)
FORWARD = changed(keeps=True, takes_back=False)
PASSES = changed(keeps=True)
HALVES = changed(halves=True)


@pytest.mark.parametrize(
    ("step", "rules", "late", "refused", "outcome"),
    [
        (NOT_MADE, PLAIN, 0, None, Outcome.SHORTEN),
        (tried(1.0), PLAIN, 0, None, Outcome.ACCEPTED),
        (tried(1.5), PLAIN, 0, None, Outcome.SHORTEN),
        (tried(math.nan), PLAIN, 0, None, Outcome.SHORTEN),
        # Good for the connections and too long for what is recorded.
        (tried(0.5, beyond=2.0), PLAIN, 0, None, Outcome.SHORTEN),
        (tried(0.5, switched=True), PLAIN, 0, None, Outcome.BISECT),
        (tried(5.0, switched=True), PASSES, 0, None, Outcome.BISECT),
        # Steps that cannot be taken back are kept; those with a jump at equal lengths, for a while.
        (tried(5.0), FORWARD, 0, None, Outcome.KEPT),
        (tried(50.0), FORWARD, 0, None, Outcome.LATE),
        (tried(50.0), FORWARD, 2, None, Outcome.LATE),
        (tried(50.0), FORWARD, 3, None, Outcome.KEPT),
        (tried(0.5), FORWARD, 3, None, Outcome.ACCEPTED),
        # Those that can are kept where they are as short as a jump is looked for, 1e-4 s here.
        (tried(50.0), PASSES, 0, None, Outcome.SHORTEN),
        (tried(50.0, 1.01e-4), PASSES, 0, None, Outcome.SHORTEN),
        (tried(50.0, 0.99e-4), PASSES, 0, None, Outcome.KEPT),
        # But not where iterations did not settle: nothing is known of the end.
        (tried(math.inf, 0.99e-4), PASSES, 0, None, Outcome.SHORTEN),
        (tried(50.0, 0.99e-4), PLAIN, 0, None, Outcome.SHORTEN),
        # A quarter of the length and nearly the error of before: it comes from the FMUs.
        (tried(2.0, 0.025, found=9e-5), HALVES, 0, (0.1, 1e-4), Outcome.FLOOR),
        (tried(2.0, 0.025, found=9e-5), HALVES, 0, None, Outcome.SHORTEN),
        (tried(2.0, 0.025, found=2e-5), HALVES, 0, (0.1, 1e-4), Outcome.SHORTEN),
        # .. more of which than the run can bear.
        (tried(2.0, 0.025, found=9e-4), HALVES, 0, (0.1, 1e-3), Outcome.SHORTEN),
    ],
)
def test_what_becomes_of_a_step(step, rules, late, refused, outcome):
    assert outcome_of(step, rules, late, refused) is outcome


def test_steps_that_are_not_taken_back():
    taken_back = {outcome for outcome in Outcome if outcome.is_taken_back}
    assert taken_back == {Outcome.SHORTEN, Outcome.BISECT}


@pytest.mark.parametrize(
    ("outcome", "step", "rules", "length"),
    [
        # The error falls with the third power: half the length has an eighth of it, less a margin.
        (Outcome.SHORTEN, tried(8.0), PLAIN, 0.9 * 0.1 / 2.0),
        (Outcome.SHORTEN, NOT_MADE, PLAIN, 0.2 * 0.1),
        (Outcome.BISECT, tried(0.5, switched=True), PLAIN, 0.05),
        (Outcome.LATE, tried(50.0), FORWARD, 0.1),
        (Outcome.KEPT, tried(8.0), FORWARD, 0.9 * 0.1 / 2.0),
        (Outcome.KEPT, tried(8.0, 1e-4), PASSES, 1e-4),
        (Outcome.FLOOR, tried(2.0, 0.025), HALVES, 0.07),
        (Outcome.ACCEPTED, tried(1e-9), PLAIN, 4.0 * 0.1),
        (Outcome.ACCEPTED, tried(1e-9), changed(FORWARD, predicts=True), 30.0 * 0.1),
        (Outcome.ACCEPTED, tried(1.0), PLAIN, 0.9 * 0.1),
        (Outcome.ACCEPTED, tried(1e-9), changed(announced=False), 0.2),
        (Outcome.ACCEPTED, tried(2e-4), changed(announced=False), 4.0 * 0.1),
    ],
)
def test_the_step_after_one_that_was_tried(outcome, step, rules, length):
    pace = Pace([])
    found = resized(StepSize(0.3), outcome, step, rules, pace, (0.07, 1e-4))
    assert found.length == pytest.approx(length, rel=1e-14)
    is_start = outcome in (Outcome.ACCEPTED, Outcome.LATE)
    assert found.rejected is not is_start, "right after a rejection, a step does not grow"


@pytest.mark.parametrize(
    ("rules", "shortest", "longest"),
    [
        (PLAIN, 1e-4, math.inf),
        (changed(tolerance=1e-6), 1e-5, math.inf),
        (changed(switches=True), 1e-4, 0.1),
        (changed(FORWARD, switches=True), 1e-4, 1e-2),
        (changed(FORWARD, switches=True, tolerance=5e-3), 5e-4, 5e-2),
    ],
)
def test_how_short_and_long_steps_may_be(rules, shortest, longest):
    assert rules.shortest == pytest.approx(shortest, rel=1e-14)
    assert rules.longest == pytest.approx(longest, rel=1e-14)
