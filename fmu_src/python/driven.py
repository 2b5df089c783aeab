"""A block driven by functions of time from profiles, never integrated across their jumps."""

from __future__ import annotations

from . import interface
from .block import Block
from .integrator import StepFailure
from .parameters import ParameterError
from .signals import Profile, ProfileError

__all__ = ["Driven"]

# A macro step with more jumps of the profiles than this is refused, as one of 10^15 s would never
# end.
MOST_JUMPS = 10_000


class Driven(Block):
    """A plant, with theta(t) = profile(t) + dtheta(t), or a block with signals from profiles.

    dtheta are inputs held over a step. The equations of a block take time after its signals.
    """

    def _bind(self):
        bound = super()._bind()
        profiles = []
        for name, fields in interface.PROFILES:
            try:
                profiles.append(Profile.from_flat({f: self._constants[vr] for f, vr in fields}))
            except ProfileError as error:
                raise ParameterError(f"{name}: {error}") from error
        self._profiles = tuple(profiles)
        # theta on the piece last asked for: from, until, the function, and its pieces.
        self._smooth = (0.0, 0.0, None, ())
        return bound

    def _theta_at(self, t):
        """theta as a function of time from t on, and the next time at which it jumps."""
        start, end, theta, _ = self._smooth
        if not start <= t < end:
            pieces = [profile.segment(t) for profile in self._profiles]
            start = max([piece.start for piece in pieces])
            end = min([piece.end for piece in pieces])
            formulas = [piece.formula() for piece in pieces]
            theta = _timed(formulas) if interface.TIMED else _joined(formulas, self._inputs)
            self._smooth = start, end, theta, pieces
        return theta, end

    def _theta_now(self):
        theta, _ = self._theta_at(self._time)
        return (theta(self._time),)

    def _theta_and_slopes_now(self):
        t = self._time
        theta, _ = self._theta_at(t)
        if not interface.TIMED:
            return (theta(t),)
        return ([*theta(t), *[piece.derivative(t) for piece in self._smooth[3]]],)

    def _further_outputs(self):
        theta, event = self._theta_at(self._time)
        outputs = dict(zip(interface.THETA, theta(self._time)))
        outputs[interface.NEXT_EVENT] = event
        return outputs

    def _advance(self, t, h):
        x, inner, start, now = self._x, self._h, 0.0, t
        if not x:
            return x, inner
        for _ in range(MOST_JUMPS):
            theta, event = self._theta_at(now)
            # A jump at the very end of the step belongs to the next one.
            if event - t >= h:
                return self._integrate(t, start, h, x, inner, theta)
            x, inner = self._integrate(t, start, event - t, x, inner, theta)
            # The time of the jump itself, not t + (event - t), which may round to before it.
            start, now = event - t, event
        raise StepFailure(
            f"the profiles jump more than {MOST_JUMPS} times in the step from t = {t:.9g}; "
            "take a smaller communication step"
        )


def _joined(formulas, inputs):
    """theta as a function of time: the formulas plus the inputs dtheta, which are held."""
    slots = interface.DTHETA_SLOTS
    if len(formulas) == 1:
        (f,), (i,) = formulas, slots
        return lambda t: (f(t) + inputs[i],)
    if len(formulas) == 2:
        (f, g), (i, j) = formulas, slots
        return lambda t: (f(t) + inputs[i], g(t) + inputs[j])
    terms = tuple(zip(formulas, slots))
    return lambda t: [f(t) + inputs[i] for f, i in terms]


def _timed(formulas):
    """The signals of a block as a function of time, and time behind them."""
    if len(formulas) == 1:
        (f,) = formulas
        return lambda t: (f(t), t)
    return lambda t: [*[f(t) for f in formulas], t]
