"""The closed loops of Figs. 2 and 3 with held inputs: as jobs for engines, and as our master runs
them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from congelation.cosim import Result, simulate
from congelation.cosim.system import System
from congelation.scenario.load import load_scenario
from congelation.scenario.scenario import Case, Scenario

ROOT = Path(__file__).parents[2]

# Measured over 0.8 s: with held inputs all four loops stay bounded up to 5 ms. At 10 ms x_2 of
# Fig. 2, Controller 1, peaks at 91 instead of 13, and Fig. 3, Controller 1, diverges.
STEP = 1e-3


@dataclass(frozen=True)
class Loop:
    """A scenario and one of its variants."""

    scenario: str
    variant: str

    def __str__(self) -> str:
        return f"{self.scenario}-{self.variant}".replace(" ", "")


LOOPS = tuple(
    Loop(scenario, variant)
    for scenario in ("fig2", "fig3")
    for variant in ("Controller 1", "Controller 2")
)


@cache
def scenario(loop: Loop) -> Scenario:
    return load_scenario(ROOT / "scenarios" / f"{loop.scenario}.toml")


@cache
def case(loop: Loop) -> Case:
    settings = {v.name: v.settings for v in scenario(loop).variants}
    return scenario(loop).case(settings[loop.variant])


def columns(loop: Loop, *variables: str) -> list[str]:
    """The recorded columns of some vectors or scalars, ``plant.x`` or ``controller.u``."""
    recorded = case(loop).system.resolve().recorded(case(loop).experiment.record)
    return [c.name for c in recorded if c.name.partition("[")[0] in variables]


@cache
def reference(loop: Loop, steps: int, step: float = STEP, coupling: str = "jacobi") -> Result:
    """Our master's run of a loop."""
    result = simulate(
        case(loop).system,
        stop_time=steps * step,
        step=step,
        coupling=coupling,
        record=case(loop).experiment.record,
    )
    assert result.completed, result.message
    assert len(result.time) == steps + 1
    return result


def twin(system: System) -> System:
    """A system with the native twins of its FMUs."""
    return replace(
        system,
        components=tuple(
            replace(c, fmu=Path(c.fmu).parent / "native" / Path(c.fmu).name)
            for c in system.components
        ),
    )


def job(loop: Loop, steps: int, step: float = STEP, *, native: bool = False) -> dict[str, object]:
    """What an engine has to do, in plain data."""
    system = twin(case(loop).system) if native else case(loop).system
    resolved = system.resolve()
    names = [member.name for member in resolved.members]
    return {
        "components": {
            c.name: {"fmu": str(c.fmu), "start": dict(c.start)} for c in system.components
        },
        "connections": [
            [names[link.source], link.output.name, names[link.target], link.input.name]
            for link in resolved.links
        ],
        "record": [column.split(".", 1) for column in case(loop).experiment.record],
        "step": step,
        "steps": steps,
    }


def deviation(
    found: dict[str, list[float]], expected: Result, names: list[str], *, first_row: int = 0
) -> float:
    """The largest deviation of some columns, relative to each one's peak (at least 1).

    Row k of `found` is held against row k + `first_row` of `expected`.
    """
    assert names
    worst = 0.0
    for name in names:
        column = expected.values[first_row:, expected.names.index(name)]
        values = np.array(found[name])
        assert values.shape == column.shape
        worst = max(worst, np.abs(values - column).max() / max(1.0, np.abs(column).max()))
    return float(worst)
