"""The loops of the paper's figures, from scenarios/, as loops for engines and as equations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.loop import Component, Loop, variables
from congelation.scenario.load import load_scenario
from congelation.scenario.scenario import Case

__all__ = ["VARIANT", "Figure", "figure", "native"]

SCENARIOS = Path(__file__).absolute().parent.parent / "scenarios"
VARIANT = "Controller 1"


@dataclass(frozen=True)
class Figure:
    """One loop of the paper, with Controller 1.

    Parameters
    ----------
    case : Case
    loop : Loop
        Of the scenario's name. It records x, u and the estimates. Start values are given where
        they are not the FMU's own.
    """

    case: Case
    loop: Loop

    @property
    def stop_time(self) -> float:
        """Of the scenario, in seconds."""
        return self.case.experiment.stop_time


def figure(name: str) -> Figure:
    """Read scenarios/`name`.toml."""
    scenario = load_scenario(SCENARIOS / f"{name}.toml")
    settings = next(v.settings for v in scenario.variants if v.name == VARIANT)
    case = scenario.case(settings)
    system = case.system.resolve()
    names = [member.name for member in system.members]
    components = tuple(
        Component(c.name, str(c.fmu.absolute()), _changed(c.fmu, c.start))
        for c in case.system.components
    )
    links = system.links
    connections = tuple(
        (names[k.source], k.output.name, names[k.target], k.input.name) for k in links
    )
    wanted = ("plant.x", "controller.u", "controller.theta_hat", "controller.rho_hat")
    columns = [r.name for r in system.recorded(case.experiment.record)]
    record = tuple(
        (owner, variable)
        for owner, _, variable in (name.partition(".") for name in columns)
        if f"{owner}.{variable.partition('[')[0]}" in wanted
    )
    return Figure(case, Loop(name, components, connections, record))


def native(found: Figure) -> Figure:
    """The same figure with the native twins."""
    folder = SCENARIOS.parent / "fmus" / "native"
    loop = replace(
        found.loop,
        components=tuple(
            replace(c, fmu=str(folder / Path(c.fmu).name)) for c in found.loop.components
        ),
    )
    return replace(found, loop=loop)


def _changed(fmu: Path, start: Mapping[str, Any]) -> dict[str, Any]:
    """The start values that are not the FMU's own; a scenario's are flat."""
    own = variables(fmu)
    return {name: value for name, value in start.items() if own[name].start != value}
