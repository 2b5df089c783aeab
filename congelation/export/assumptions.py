"""What the theorem does not allow of a design that FMUs are to be built of."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from congelation.export.spec import Spec
from congelation.signals import Profile
from congelation.theory.assumptions import KnownTheta, Remark, remarks_on

__all__ = ["degree_of", "known_theta", "spec_assumptions", "spec_warnings"]

_UNSURE = {
    "table": "is read from a table, which may be exchanged",
    "telegraph": "has a random term",
    "noise": "has a random term",
}
"""Terms whose values are not in the formula of the profile, and what is said of them."""


def spec_assumptions(spec: Spec) -> tuple[Remark, ...]:
    """The assumptions that a spec breaks, and what cannot be known of them."""
    profiles = [slots.profile for slots in spec.plant.profiles]
    absent = [j for j in range(len(profiles)) if f"theta[{j + 1}]" not in spec.plant.stated]

    def place(name: str) -> str:
        if name.startswith("theta["):
            return f'plant.profile."{name}"'
        return f"controller.start.{name}"

    model = spec.controller.model
    return remarks_on(
        model.defaults() | {f"{s.variables.name}0": s.start for s in model.states},
        known_theta(profiles, (0.0,) * len(profiles), absent),
        degree_of(spec.form, spec.structure),
        place,
        spec.controller.stated,
        varying_gain=spec.structure.get("gain") == "varying",
    )


def spec_warnings(spec: Spec) -> tuple[str, ...]:
    """One line for each remark on a spec: where, what, and what would do."""
    return tuple(str(remark) for remark in spec_assumptions(spec))


def degree_of(form: str, structure: Mapping[str, object]) -> int | None:
    """m of the plant (27), or None for the forms that have no b."""
    return int(str(structure["m"])) if form == "observer" else None


def known_theta(
    profiles: Sequence[Profile],
    offsets: Sequence[float],
    absent: Collection[int],
    driven: Collection[int] = (),
) -> KnownTheta:
    """What is known of theta(t) from its profiles.

    Parameters
    ----------
    profiles, offsets : sequence
        Of each element, and the constant dtheta added to it.
    absent, driven : collection of int
        Elements (from 0) without a profile, and those whose dtheta comes from another component.
    """
    bounds = [
        (low + offset, high + offset)
        for (low, high), offset in zip((p.bounds() for p in profiles), offsets, strict=True)
    ]
    unsure = {}
    for j, p in enumerate(profiles):
        reasons = [_UNSURE[kind] for kind in _UNSURE if kind in {t.kind for t in p.terms}]
        reasons += ["has an input, dtheta, that another component drives"] if j in driven else []
        if reasons:
            unsure[j] = " and ".join(reasons)
    low, high = zip(*bounds, strict=True) if bounds else ((), ())
    return KnownTheta(tuple(low), tuple(high), frozenset(absent).difference(driven), unsure)
