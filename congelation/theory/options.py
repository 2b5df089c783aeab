"""What a law copes with beyond the paper, and the inputs from outside the loop."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from congelation.theory.model import Variables, vector

__all__ = ["Options", "disturbance", "reference"]


@dataclass(frozen=True)
class Options:
    """What a law copes with, beyond the parameters theta(t) of the paper.

    Attributes
    ----------
    tracking : bool
        The output follows a reference y_r, whose derivatives are inputs.
    varying_gain : bool
        The plant's input gain b(t) is unknown and varies; its sign is known. State feedback only.
    unknown_radius : bool
        The radius delta is not known; the term of the damping that holds it is estimated.
    bound_estimator : bool
        In place of congelation's damping: what varies is a disturbance of bounded size, and the
        bound is estimated. State feedback, without the two before.
    disturbance : bool
        The plant is disturbed, x' = .. + d(t), and the law has damping against d.
    Upsilon : tuple of tuple of str, p of q
        Structured variations, theta(t) = Upsilon(t) vartheta + theta_u(t): known functions of time
        as formulas in ``t``, unknown constants vartheta, and a rest of the radius delta. Empty:
        nothing of the variations is known. State feedback.
    """

    tracking: bool = False
    varying_gain: bool = False
    unknown_radius: bool = False
    bound_estimator: bool = False
    disturbance: bool = False
    Upsilon: tuple[tuple[str, ...], ...] = ()

    def __str__(self) -> str:
        named = {
            "tracking": self.tracking,
            "varying gain": self.varying_gain,
            "unknown radius": self.unknown_radius,
            "bound estimator": self.bound_estimator,
            "disturbance": self.disturbance,
            "structured variations": self.Upsilon,
        }
        return ", ".join(name for name, chosen in named.items() if chosen)


def reference(order: int) -> Variables:
    """The input yr[0] .. yr[order]: a reference and its derivatives."""
    about = "Reference y_r and its derivatives y_r^(j)"
    return Variables("yr", ca.SX.sym("yr", order + 1), about, first=0)


def disturbance(n: int) -> Variables:
    """The input d[1] .. d[n] of a plant: x' = .. + d(t)."""
    return vector("d", n, "Disturbance d(t), added to x'")
