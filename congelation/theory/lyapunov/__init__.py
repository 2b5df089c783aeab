"""The Lyapunov functions of the four designs, as certificates of their closed loops."""

from congelation.theory.lyapunov.output_feedback import output_feedback_certificate
from congelation.theory.lyapunov.plain import matched_certificate, scalar_certificate
from congelation.theory.lyapunov.state_feedback import state_feedback_certificate

__all__ = [
    "matched_certificate",
    "output_feedback_certificate",
    "scalar_certificate",
    "state_feedback_certificate",
]
