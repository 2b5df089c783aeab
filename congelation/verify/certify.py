"""Whether a design keeps its promise: a search for states where the Lyapunov inequality fails.

A design promises V' <= -(rate of decay) for every theta(t) in a ball of radius delta. The search
(`congelation.theory.certificate`) evaluates the worst case over that ball in closed form; whether
the profile of theta stays in the ball is looked at here.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from congelation.errors import InvalidInput
from congelation.export.spec import read_spec
from congelation.scenario.load import load_scenario
from congelation.signals import box_radius
from congelation.theory.certificate import Certificate, Finding
from congelation.theory.closed_loop import ClosedLoop, close
from congelation.theory.lyapunov import (
    matched_certificate,
    output_feedback_certificate,
    scalar_certificate,
    state_feedback_certificate,
)
from congelation.verify.reference import reference

__all__ = ["Certification", "Design", "certificate_of", "certify", "designs_of"]

_CERTIFICATES: Mapping[str, Callable[[ClosedLoop], Certificate]] = {
    "ScalarController": scalar_certificate,
    "MatchedController": matched_certificate,
    "StateFeedbackController": state_feedback_certificate,
    "OutputFeedbackController": output_feedback_certificate,
}

BALL_ROUNDING = 1e-4
"""Relative excess of a profile's radius over delta that counts as rounding of the written delta."""


@dataclass(frozen=True)
class Design:
    """A closed loop with numbers for all parameters, and the radius of the box of its theta(t)."""

    name: str
    loop: ClosedLoop
    radius: float


@dataclass(frozen=True)
class Certification:
    """What the search found of one design."""

    design: Design
    finding: Finding

    @property
    def delta(self) -> float:
        """The radius that the design is made for."""
        return float(self.design.loop.values["delta"].item())

    @property
    def leaves_ball(self) -> bool:
        """Whether theta(t) leaves the ball that the design is made for."""
        return self.design.radius > self.delta * (1.0 + BALL_ROUNDING)

    @property
    def holds(self) -> bool:
        """No violation was found, and theta(t) stays where the design wants it."""
        return not self.finding.violated and not self.leaves_ball


def certificate_of(loop: ClosedLoop) -> Certificate:
    """The certificate of a loop, by the name of its controller's model."""
    return _CERTIFICATES[loop.controller.name](loop)


def certify(design: Design, samples: int = 1000, seed: int = 0) -> Certification:
    """Search the state space of a design for a violation.

    Parameters
    ----------
    design : Design
    samples : int
        Random states to try, before local ascents from the worst of them.
    seed : int
        Of the random states.

    Raises
    ------
    InvalidInput
        If the numbers of the design are too large or too small to be searched.
    """
    try:
        return Certification(design, certificate_of(design.loop).search(samples, seed=seed))
    except InvalidInput as error:
        raise InvalidInput(f"{design.name}: {error}") from error


def designs_of(file: Path) -> Sequence[Design]:
    """The designs in a spec (one) or a scenario (one for each variant).

    Raises
    ------
    InvalidInput
        If the file is neither, or a variant is no loop of a plant and its controller.
    """
    return _of_spec(file) if _is_spec(file) else _of_scenario(file)


def _is_spec(file: Path) -> bool:
    """Whether a readable TOML file has the key that only specs have."""
    try:
        return "form" in tomllib.loads(file.read_text("utf-8"))
    except (OSError, ValueError):
        # What is wrong with it is said by the reader of scenarios.
        return False


def _of_spec(file: Path) -> list[Design]:
    spec = read_spec(file)
    loop = close(spec.plant.model, spec.controller.model, spec.controller.model.defaults())
    profiles = [slots.profile for slots in spec.plant.profiles]
    return [Design(spec.title, loop, box_radius(profiles))]


def _of_scenario(file: Path) -> list[Design]:
    scenario = load_scenario(file)
    designs = []
    for variant in scenario.variants:
        case = scenario.case(variant.settings)
        try:
            found = reference(case)
        except InvalidInput as error:
            raise InvalidInput(f"{file}: {variant.name}: {error}") from error
        designs.append(Design(variant.name, found.loop, box_radius(found.profiles)))
    return designs
