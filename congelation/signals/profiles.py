"""The sum of terms, and the box that a vector of such sums stays in."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any

from .checks import ProfileError
from .flat import DEFAULT_SLOTS, Slots, flat_of_terms, terms_of_flat
from .kinds import KINDS
from .segment import Segment, joined
from .spec import spec_of_terms, terms_of_spec
from .terms import Constant, Term

__all__ = ["COINCIDENT", "Profile", "box_radius", "profile"]

# Events closer than this, relative to max(1, |t|), happen together: thousands of units in the
# last place, so an integrator is never asked for a step that rounding would swallow.
COINCIDENT = 1e-12


@dataclass(frozen=True)
class Profile:
    """The sum of `terms`; see the head of this package.

    Parameters
    ----------
    terms : sequence of Term
        Empty: the profile is 0.

    Raises
    ------
    ProfileError
        If something is not a `Term`, or the bounds overflow.
    """

    terms: tuple[Term, ...] = ()
    # The terms that hold for all time, joined once, and those that have events.
    _fixed: Segment = field(init=False, repr=False, compare=False)
    _eventful: tuple[Term, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for term in self.terms:
            if not isinstance(term, Term):
                raise ProfileError(f"{reprlib.repr(term)}: must be one of " + ", ".join(KINDS))
        object.__setattr__(self, "terms", tuple(self.terms))
        try:
            self.bounds()
        except OverflowError:
            raise ProfileError(f"{reprlib.repr(self.terms)}: the sum must be finite") from None
        first = [(term, term.segment(0.0)) for term in self.terms]
        fixed = [piece for _, piece in first if piece.start == -inf and piece.end == inf]
        eventful = tuple(term for term, piece in first if piece.start > -inf or piece.end < inf)
        object.__setattr__(self, "_fixed", joined(Segment(-inf, inf), fixed, -inf))
        object.__setattr__(self, "_eventful", eventful)

    def segment(self, t: float) -> Segment:
        """The piece at `t`: ``start <= t < end``.

        Events within `COINCIDENT` (relative) after another one are taken to happen with it. Every
        segment is longer than that, so that stepping from end to end always advances.
        """
        if not -inf < t < inf:
            raise ProfileError(f"t = {t!r}: must be a finite number")
        if not self._eventful:
            return self._fixed
        pieces = [term.segment(t) for term in self._eventful]
        start = max([piece.start for piece in pieces])
        if start > -inf:
            settled = start + COINCIDENT * max(1.0, abs(start))
            if min([piece.end for piece in pieces]) <= settled:
                pieces = [term.segment(settled) for term in self._eventful]
        return joined(self._fixed, pieces, start)

    def value(self, t: float) -> float:
        """Value at `t` (s); at a jump, the value after it."""
        return self.segment(t).value(t)

    def derivative(self, t: float) -> float:
        """Derivative at `t` (s); at an event, the one after it."""
        return self.segment(t).derivative(t)

    def next_event(self, t: float) -> float:
        """The first event strictly after `t`, s; inf if there is none."""
        return self.segment(t).end

    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound over all time: the sums of the terms' bounds.

        Reached exactly by terms of unrelated periods, such as those of system (60) in our
        profile; for others the range may be smaller.
        """
        pairs = [term.bounds() for term in self.terms]
        return math.fsum([low for low, _ in pairs]), math.fsum([high for _, high in pairs])

    @property
    def radius(self) -> float:
        """Half the distance between the bounds: this component's share of δ, cf. `box_radius`."""
        low, high = self.bounds()
        return high / 2.0 - low / 2.0

    @classmethod
    def from_spec(cls, spec: Any, where: str = "profile", base: str = "") -> Profile:
        """The profile that a list of one-key tables describes, as read from TOML.

        Parameters
        ----------
        spec : list of dict
            Such as ``[{"constant": -3.0}, {"sine": {"amplitude": 0.6, "omega": 0.4}}]``; a number
            alone is a constant. Keys: the fields of the terms; a table has `times` and `values`,
            or `file`, and may have `linear`.
        where : str
            Place of `spec` in its file, for messages.
        base : str
            Folder to which the files of tables are relative.

        Raises
        ------
        ProfileError
            Naming the path (terms counted from 1), the value, and the nearest valid key.
        """
        return cls(terms_of_spec(spec, where, base))

    def to_spec(self) -> list[dict[str, Any]]:
        """The list that `from_spec` turns into an equal profile."""
        return spec_of_terms(self.terms)

    @classmethod
    def from_flat(cls, values: Mapping[str, Any], base: str = "") -> Profile:
        """The profile that flat parameters describe; those left out have their defaults.

        Parameters
        ----------
        values : mapping of str to float, int, bool or str
            By the names of `flat_parameters`. Terms of amplitude 0 are checked, then dropped.
        base : str
            Folder to which a relative ``table.file`` is relative.

        Raises
        ------
        ProfileError
            Naming the parameter, the value, and the nearest valid name.
        """
        return cls(terms_of_flat(values, base))

    def to_flat(self, slots: Slots = DEFAULT_SLOTS) -> dict[str, Any]:
        """All flat parameters for `slots`; constants are added up into ``mean``.

        Raises
        ------
        ProfileError
            If there are more terms of a kind than slots, or a table that has no file.
        """
        return flat_of_terms(self.terms, slots)


def profile(*terms: Term | float) -> Profile:
    """The sum of `terms`, numbers among them standing for constants."""
    return Profile(tuple(t if isinstance(t, Term) else Constant(t) for t in terms))


def box_radius(profiles: Sequence[Profile]) -> float:
    """δ = |θ_max - θ_min|/2 of the box that holds the vector of these profiles (Sec. II)."""
    return math.sqrt(sum([p.radius**2 for p in profiles], 0.0))
