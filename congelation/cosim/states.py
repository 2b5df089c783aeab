"""The states of all slaves together: saved, and restored."""

from __future__ import annotations

from collections.abc import Sequence

from congelation.cosim.system import ResolvedSystem
from congelation.errors import InvalidInput
from congelation.fmi.slave import Slave

__all__ = ["Checkpoint", "require_states"]


class Checkpoint:
    """One saved state of every slave.

    Parameters
    ----------
    slaves : sequence of Slave

    Attributes
    ----------
    calls : int
        fmi2 calls made so far.
    """

    def __init__(self, slaves: Sequence[Slave]) -> None:
        self._slaves = tuple(slaves)
        self._states = [slave.save() for slave in slaves]
        self._pairs = list(zip(slaves, self._states, strict=True))
        self.calls = len(self._pairs)

    def save(self) -> None:
        """Save the states as they are now, over those saved before."""
        for slave, state in self._pairs:
            slave.save_into(state)
        self.calls += 2 * len(self._pairs)

    def restore(self) -> None:
        """Back to the saved states."""
        for slave, state in self._pairs:
            slave.restore(state)
        self.calls += len(self._pairs)


def require_states(system: ResolvedSystem, purpose: str) -> None:
    """Refuse FMUs that cannot be taken back.

    Raises
    ------
    InvalidInput
        Names the component, the purpose and what to use instead.
    """
    for member in system.members:
        if not member.description.can_get_and_set_state:
            raise InvalidInput(
                f"component '{member.name}': {member.description.path.name} cannot get and set "
                f"its state, which {purpose} needs; use the coupling 'derivative' with a fixed step"
            )
