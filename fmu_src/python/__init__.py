"""What the FMUs have in common. Nothing may be imported before `exit_guard`."""

from . import exit_guard

__all__ = ["exit_guard"]
