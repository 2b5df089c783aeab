"""A delay: the input of the past, kept as the cubics that it was over each step."""

from __future__ import annotations

from math import inf

from . import interface
from .block import Block
from .integrator import StepFailure

__all__ = ["Delay"]

# Steps that the memory holds at most: a delay of 10 s in steps of 0.1 ms.
MOST_PIECES = 100_000
# A jump of the input counts, and is announced, from this part of its largest value on. Below it
# lies where the pieces of a master that extrapolates do not meet; to announce those would divide
# its steps, and the divided steps would leave as many again.
JUMP = 1e-3


class Delay(Block):
    """y(t) = u(t - delay).

    In place of states the block has its memory, oldest first: for each step (start, length,
    cubics, jumps, largest), `jumps` telling whether the input jumps at the start, and `largest` the
    largest input so far. What has come out is forgotten, but for the piece that is coming out.
    """

    def _bind(self):
        bound = super()._bind()
        references = {name: vrs for name, _, vrs, _, _ in interface.PARAMETERS}
        (delay,) = references["delay"]
        self._delay = self._constants[delay]
        self._before = [self._constants[vr] for vr in references["before"]]
        return bound

    def _coming_out(self):
        """The coefficients of each input in the piece that comes out now, and the time in it."""
        t, delay, now = self._time, self._delay, None
        for piece in self._x:
            # The time at which a piece comes out is announced, and is never computed otherwise.
            if piece[0] + delay > t:
                break
            now = piece
        if now is None:
            return [(value, 0.0, 0.0, 0.0) for value in self._before], 0.0
        start, length, cubics, _, _ = now
        return cubics, min(max(t - delay - start, 0.0), length)

    def _theta_now(self):
        cubics, s = self._coming_out()
        return ([*[a + s * (b + s * (c + s * d)) for a, b, c, d in cubics], self._time],)

    def _theta_and_slopes_now(self):
        (theta,) = self._theta_now()
        cubics, s = self._coming_out()
        return ([*theta, *[b + s * (2.0 * c + s * 3.0 * d) for _, b, c, d in cubics]],)

    def _further_outputs(self):
        t, delay = self._time, self._delay
        events = [start + delay for start, _, _, jumps, _ in self._x if jumps and start + delay > t]
        # A jump of the inputs just set will be part of the memory with the next step.
        if not events and self._jumps(self._values_now())[0]:
            events.append(t + delay)
        return {interface.NEXT_EVENT: min(events, default=inf)}

    def _jumps(self, values):
        """Whether inputs of these values do not go on from the memory, and the largest so far."""
        largest = max([abs(value) for value in values])
        if self._x:
            _, h, cubics, _, before = self._x[-1]
            largest = max(largest, before)
            ended = [a + h * (b + h * (c + h * d)) for a, b, c, d in cubics]
        else:
            ended = self._before
        return any([abs(v - e) > JUMP * largest for v, e in zip(values, ended)]), largest

    def _advance(self, t, h):
        memory, delay = self._x, self._delay
        cubics = tuple(self._cubics())
        ends = [a + h * (b + h * (c + h * d)) for a, b, c, d in cubics]
        if not all([value - value == 0.0 for value in ends]):
            raise OverflowError
        jumps, largest = self._jumps([a for a, _, _, _ in cubics])
        memory += ((t, h, cubics, jumps, largest),)
        forgotten = 0
        while forgotten + 1 < len(memory) and memory[forgotten + 1][0] + delay <= t + h:
            forgotten += 1
        if len(memory) - forgotten > MOST_PIECES:
            raise StepFailure(
                f"delay = {delay:.9g} holds more than {MOST_PIECES} steps of this length; take a "
                "longer communication step, or a shorter delay"
            )
        return memory[forgotten:], self._h
