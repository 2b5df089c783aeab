"""A plant: a block driven by unknown parameters theta(t), never integrated across their jumps."""

from __future__ import annotations

from . import interface
from .block import Block
from .parameters import ParameterError
from .signals import Profile, ProfileError

__all__ = ["Plant"]


class Plant(Block):
    """A block with theta(t) = profile(t) + dtheta(t), dtheta being an input held over a step."""

    def _bind(self):
        bound = super()._bind()
        profiles = []
        for name, fields in interface.PROFILES:
            try:
                profiles.append(Profile.from_flat({f: self._constants[vr] for f, vr in fields}))
            except ProfileError as error:
                raise ParameterError(f"{name}: {error}") from error
        self._profiles = tuple(profiles)
        self._pieces = tuple(profile.segment(self._time) for profile in profiles)
        return bound

    def _pieces_at(self, t):
        """The smooth pieces of all profiles that hold from t on, and where the first one ends."""
        pieces = self._pieces
        if not all([piece.start <= t < piece.end for piece in pieces]):
            pieces = self._pieces = tuple(
                piece if piece.start <= t < piece.end else profile.segment(t)
                for piece, profile in zip(pieces, self._profiles)
            )
        return pieces, min([piece.end for piece in pieces])

    def _offsets(self):
        return [self._inputs[slot] for slot in interface.DTHETA_SLOTS]

    def _theta_of(self, pieces):
        """theta as a function of time while the pieces hold."""
        terms = [(piece.value, offset) for piece, offset in zip(pieces, self._offsets())]
        return lambda t: [value(t) + offset for value, offset in terms]

    def _theta_now(self):
        pieces, _ = self._pieces_at(self._time)
        return (self._theta_of(pieces)(self._time),)

    def _further_outputs(self, theta):
        outputs = dict(zip(interface.THETA, theta))
        outputs[interface.NEXT_EVENT] = self._pieces_at(self._time)[1]
        return outputs

    def _advance(self, t, h):
        x, inner, start, now = self._x, self._h, 0.0, t
        while True:
            pieces, event = self._pieces_at(now)
            theta = self._theta_of(pieces)
            # A jump at the very end of the step belongs to the next one.
            if event - t >= h:
                return self._integrate(t, start, h, x, inner, theta)
            x, inner = self._integrate(t, start, event - t, x, inner, theta)
            # The time of the jump itself, not t + (event - t), which may round to before it.
            start, now = event - t, event
