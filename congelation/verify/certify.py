"""Whether a design keeps its promise: its assumptions, then a search for a state that breaks it.

A design promises V' <= -(rate of decay), plus a residue under leakage, for every theta(t) in a ball
of radius delta. The search (`congelation.theory.certificate`) evaluates the worst case over that
ball in closed form; whether the theorem may be applied at all (`congelation.theory.assumptions`) is
looked at first, because the inequality does not show it.
"""

from __future__ import annotations

import enum
import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from congelation.arguments import checked
from congelation.errors import InvalidInput, counted, require_count
from congelation.export.spec import Spec, read_spec
from congelation.export.spec_assumptions import HORIZON, spec_assumptions, structured
from congelation.scenario.load import load_scenario
from congelation.scenario.scenario import Case, Scenario
from congelation.signals import Profile, box_radius
from congelation.theory.adaptation import claim_of
from congelation.theory.assumptions import Remark
from congelation.theory.certificate import Certificate, Finding
from congelation.theory.closed_loop import ClosedLoop, close
from congelation.theory.lyapunov import (
    matched_certificate,
    output_feedback_certificate,
    scalar_certificate,
    state_feedback_certificate,
)
from congelation.theory.saturation import Level, largest_level
from congelation.verify.reference import reference
from congelation.verify.scenario_assumptions import case_assumptions, loops_of

__all__ = [
    "Certification",
    "Design",
    "Verdict",
    "certificate_of",
    "certify",
    "certify_design",
    "designs_of",
]

_CERTIFICATES: Mapping[str, Callable[[ClosedLoop], Certificate]] = {
    "ScalarController": scalar_certificate,
    "MatchedController": matched_certificate,
    "StateFeedbackController": state_feedback_certificate,
    "OutputFeedbackController": output_feedback_certificate,
}

LEAST_RESOLVED = 0.01
"""The claimed rate has to stand out of the rounding at this part of the states drawn, at least. The
designs of specs/ reach more than 0.5, random ones of order 4 with epsilon about 1 at least 0.05."""


class Verdict(enum.Enum):
    """What `certify` says of a design; the value is the sentence for it."""

    HOLDS = "no state was found at which V' exceeds what the design promises"
    VIOLATED = "V' exceeds what the design promises"
    NOT_CLAIMED = "no certificate is claimed for this adaptation law"
    ASSUMPTION_BROKEN = "an assumption of the theorem is broken"
    PRECISION = "double precision does not suffice to tell whether V' keeps the promise"


@dataclass(frozen=True)
class Design:
    """A closed loop with numbers for all parameters, and what is known of its theta(t).

    Attributes
    ----------
    name : str
    loop : ClosedLoop
    radius : float
        Of the box that theta(t) fills; in output feedback of the box of a(t).
    remarks : tuple of Remark
        The assumptions that it breaks, and what cannot be known of them.
    center, half : tuple of float
        Centre and half the sides of the box that theta(t) fills.
    start : tuple of float
        Start values of the loop's states.
    """

    name: str
    loop: ClosedLoop
    radius: float
    remarks: tuple[Remark, ...] = ()
    center: tuple[float, ...] = ()
    half: tuple[float, ...] = ()
    start: tuple[float, ...] = ()


@dataclass(frozen=True, repr=False)
class Certification:
    """What was found of one design.

    Attributes
    ----------
    design : Design
    verdict : Verdict
    reasons : tuple of str
        One line each: the broken assumptions, or what the verdict rests on.
    finding : Finding or None
        The worst state that the search met; None where there was nothing to search, or where no
        state had a finite margin.
    level : Level or None
        Of a design that holds and was asked for limits of its control: the largest level set of V
        on which it stays within them; None where there is none, which `unlevelled` explains.
    unlevelled : str
    ultimate : float or None
        Of a design that holds under leakage: what V ends below. None where V tends to 0, or where
        the bound depends on a reference or a disturbance (metric ``ultimate_bound``).
    """

    design: Design
    verdict: Verdict
    reasons: tuple[str, ...]
    finding: Finding | None = None
    level: Level | None = None
    unlevelled: str = ""
    ultimate: float | None = None

    def __repr__(self) -> str:
        """The verdict and its reasons; the design itself would fill pages."""
        lines = [f"{self.design.name}: {self.verdict.value}"]
        lines += [f"  {reason}" for reason in self.reasons]
        if self.ultimate is not None:
            lines.append(f"  V ends below {self.ultimate:.6g}")
        lines += [f"  warning: {warning}" for warning in self.warnings]
        return "\n".join(lines)

    @property
    def delta(self) -> float | None:
        """The radius that the design is made for; None: for any."""
        values = self.design.loop.values
        return float(values["delta"].item()) if "delta" in values else None

    @property
    def holds(self) -> bool:
        """Whether the assumptions stand and no violation was found."""
        return self.verdict is Verdict.HOLDS

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line for each thing that cannot be known of the assumptions, or is left out."""
        return tuple(str(remark) for remark in self.design.remarks if not remark.broken)


def certificate_of(loop: ClosedLoop) -> Certificate:
    """The certificate of a loop, by the name of its controller's model.

    Raises
    ------
    InvalidInput
        If there is none for its law, or for its parameters.
    """
    name = loop.controller.name
    if name not in _CERTIFICATES:
        raise InvalidInput(f"{name} has no certificate (docs/rivals.md)")
    return _CERTIFICATES[name](loop)


@checked
def certify(
    what: Path | str | Spec | Scenario,
    *,
    samples: int = 1000,
    seed: int = 0,
    umax: float | None = None,
) -> tuple[Certification, ...]:
    """Check the assumptions of designs, and search for states where V' exceeds its promise.

    Parameters
    ----------
    what : Path, str, Spec or Scenario
        A spec has one design, a scenario one for each variant.
    samples : int
        Random states to try, before local ascents from the worst of them.
    seed : int
        Of the random states.
    umax : float, optional
        Limit of the size of a saturated control, in the unit of u: for each design that holds, the
        largest level set of V in which it never saturates is looked for.

    Returns
    -------
    tuple of Certification
        What was found of each design: its verdict, the reasons, and the worst state.

    Raises
    ------
    InvalidInput
        If there is no such file, or no Lyapunov function for the parameters of a design.

    Examples
    --------
    >>> (found,) = cg.certify("specs/scalar.toml", samples=50)
    >>> found.verdict.name
    'HOLDS'
    """
    if umax is not None and not 0.0 < umax < math.inf:
        raise InvalidInput(f"umax = {umax!r} is not valid; give a positive number")
    require_count(samples, "samples")
    if seed < 0:
        raise InvalidInput(f"seed = {seed} is not valid; give a whole number that is not negative")
    found = [certify_design(design, samples, seed) for design in designs_of(what)]
    if umax is None:
        return tuple(found)
    return tuple(_with_level(one, umax, seed) if one.holds else one for one in found)


def _with_level(found: Certification, umax: float, seed: int) -> Certification:
    """What was found of a design that holds, and its level set within the limits of the control."""
    design = found.design
    center, half = np.array(design.center), np.array(design.half)
    if not np.isfinite([*center, *half]).all():
        return replace(found, unlevelled="theta(t) has no bounds, which say what ell is")
    certificate = certificate_of(design.loop)
    ell = certificate.perturbations.ell(center, half)
    try:
        level = largest_level(certificate, umax, ell, design.start, seed)
    except InvalidInput as error:
        return replace(found, unlevelled=str(error))
    return replace(found, level=level)


def certify_design(design: Design, samples: int = 1000, seed: int = 0) -> Certification:
    """Check the assumptions of a design, then search its state space for a violation.

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
        If there is no Lyapunov function for the parameters of the design.
    """
    broken = tuple(str(remark) for remark in design.remarks if remark.broken)
    if broken:
        return Certification(design, Verdict.ASSUMPTION_BROKEN, broken)
    states = [s.variables for s in design.loop.controller.states]
    for estimate in (v for v in states if v.name.endswith("_hat")):
        law = claim_of(design.loop.values, estimate.name, estimate.symbol.numel())
        if law.leaves_open:
            return Certification(design, Verdict.NOT_CLAIMED, (law.leaves_open,))
    if design.loop.controller.name not in _CERTIFICATES:
        reason = "its proof rests on constants that are not known (docs/rivals.md)"
        return Certification(design, Verdict.NOT_CLAIMED, (reason,))
    try:
        certificate = certificate_of(design.loop)
    except InvalidInput as error:
        raise InvalidInput(f"{design.name}: {error}") from error
    try:
        finding = certificate.search(samples, seed=seed)
    except InvalidInput as error:  # nothing is finite
        return Certification(design, Verdict.PRECISION, (str(error),))
    if finding.violated:
        return Certification(design, Verdict.VIOLATED, (_violation(finding),), finding)
    if finding.resolved < LEAST_RESOLVED * samples:
        reason = (
            f"the promised rate is below the rounding of V' at {samples - finding.resolved} of "
            f"{counted(samples, 'state')}; give parameters nearer to 1, the most extreme "
            f"is {finding.extreme}"
        )
        return Certification(design, Verdict.PRECISION, (reason,), finding)
    ultimate = None
    known = np.isfinite([*design.center, *design.half]).all() and bool(design.center)
    if known and design.loop.controller.Upsilon is None and not certificate.terms.residue.is_zero():
        ell = certificate.perturbations.ell(np.array(design.center), np.array(design.half))
        ultimate = certificate.ultimate(ell)
    return Certification(design, Verdict.HOLDS, (), finding, ultimate=ultimate)


def _violation(finding: Finding) -> str:
    state = ", ".join(f"{name} = {value:.4g}" for name, value in finding.state.items())
    promise = "promised rate" if finding.margin.residue == 0 else "promised rate - residue"
    return f"V' + {promise} = {finding.margin.value:.4g} > 0 at {state}"


def designs_of(source: Path | str | Spec | Scenario) -> Sequence[Design]:
    """The designs in a spec (one) or a scenario (one for each variant), or in a file of either.

    Raises
    ------
    InvalidInput
        If the file is neither, or a variant is no loop of a plant and its controller.
    """
    if isinstance(source, (str, Path)):
        file = Path(source)
        source = read_spec(file) if _is_spec(file) else load_scenario(file)
    return _of_spec(source) if isinstance(source, Spec) else _of_scenario(source)


def _is_spec(file: Path) -> bool:
    """Whether a readable TOML file has the key that only specs have."""
    try:
        return "form" in tomllib.loads(file.read_text("utf-8-sig"))
    except (OSError, ValueError):
        # What is wrong with it is said by the reader of scenarios.
        return False


def _of_spec(spec: Spec) -> list[Design]:
    loop = close(spec.plant.model, spec.controller.model, spec.controller.model.defaults())
    profiles = [slots.profile for slots in spec.plant.profiles]
    radius = _radius(loop, profiles, (0.0,) * len(profiles), HORIZON)
    bounds = [profile.bounds() for profile in profiles]
    start = tuple(loop.start().tolist())
    return [Design(spec.title, loop, radius, spec_assumptions(spec), *_box(bounds), start)]


def _box(bounds: Sequence[tuple[float, float]]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Centre and half the sides of a box."""
    middle = tuple(low / 2 + high / 2 for low, high in bounds)
    return middle, tuple(high / 2 - low / 2 for low, high in bounds)


def _of_scenario(scenario: Scenario) -> list[Design]:
    designs = []
    for variant in scenario.variants:
        case = scenario.case(variant.settings)
        try:
            found = reference(_alone(case))
            remarks = case_assumptions(case)
        except InvalidInput as error:
            raise InvalidInput(f"{scenario.place}: {variant.name}: {error}") from error
        stop = case.experiment.stop_time
        radius = _radius(found.loop, found.profiles, found.offsets, stop)
        bounds = [
            (low + offset, high + offset)
            for (low, high), offset in zip(
                (profile.bounds() for profile in found.profiles), found.offsets, strict=True
            )
        ]
        start = tuple(found.start.tolist())
        disturbed = found.disturbed or any(
            _input_of(c.target) == "d" for c in case.system.connections
        )
        loop = found.opened(disturbed)
        designs.append(Design(variant.name, loop, radius, remarks, *_box(bounds), start))
    return designs


def _alone(case: Case) -> Case:
    """The one loop of a case, without what drives its dtheta, its reference or its disturbance.

    The certificate holds for each of them, however they come about.
    """
    loops = loops_of(case)
    driven = [c for c in case.system.connections if _input_of(c.target) in _OUTSIDE]
    if len(loops) != 1 or not driven:
        return case
    names = {component.name for component in loops[0]}
    connections = tuple(
        c
        for c in case.system.connections
        if _input_of(c.target) not in _OUTSIDE
        and {c.source.split(".")[0], c.target.split(".")[0]} == names
    )
    return replace(case, system=replace(case.system, components=loops[0], connections=connections))


_OUTSIDE = ("dtheta", "yr", "d")
"""Inputs by which theta(t), a reference or a disturbance come in."""


def _input_of(target: str) -> str:
    """``yr`` of ``controller.yr[1]``."""
    return target.partition(".")[2].split("[")[0]


def _radius(
    loop: ClosedLoop, profiles: Sequence[Profile], offsets: Sequence[float], stop: float
) -> float:
    """The radius that delta is to cover.

    That of a(t) alone in output feedback, of what Upsilon(t) leaves where it is known, and not of
    an input gain b(t).
    """
    if "sign_b_m" in loop.values:
        n = loop.state("plant", "x").symbol.numel()
        return box_radius(profiles[len(profiles) - n :])
    split = structured(loop.controller, profiles, offsets, stop=stop)
    if split is not None:
        return float(np.linalg.norm(split.radii))
    return box_radius(profiles[: loop.state("controller", "theta_hat").symbol.numel()])
