"""Short scenarios for the tests: a scalar loop whose text the tests change."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[1]
FMUS = ROOT / "fmus"
SHIPPED = tuple(sorted((ROOT / "scenarios").glob("*.toml")))

FIGURE = """
[[figures]]
name = "loop"
panels = ["plant.x", "controller.u"]
"""
SCALAR = f"""
title = "A short loop"
connections = ["plant.x -> controller.x", "controller.u -> plant.u"]

[components.plant]
fmu = "{FMUS}/ScalarPlant.fmu"
start = {{x0 = [1.0]}}

[components.plant.profile]
"theta[1]" = [{{constant = -3.0}}, {{square = {{amplitude = 0.4, period = 0.3}}}}]

[components.controller]
fmu = "{FMUS}/ScalarController.fmu"
start = {{k_bar = 0.5, epsilon = 0.3}}

[experiment]
stop_time = 1.0
step = 0.01
record = ["plant.x", "controller.theta_hat"]

[metrics]
peak_x = {{metric = "peak", of = "plant.x"}}
settling_x = {{metric = "settling_time", of = "plant.x", below = 0.1}}
{FIGURE}
[[variants]]
name = "Controller 1"
set = {{"controller.damping" = true}}

[[variants]]
name = "Controller 2"
set = {{"controller.damping" = false}}
"""

UNDRAWN = (FIGURE, "")
"""Without its figure, which takes a second to draw: for runs that are about something else."""


def write(folder: Path, text: str = SCALAR, *changes: tuple[str, str]) -> Path:
    """A scenario file with every change (old, new) made to `text`; each has to apply."""
    for old, new in changes:
        if old not in text:
            raise ValueError(f"'{old}' is not in the scenario")
        text = text.replace(old, new)
    file = folder / "loop.toml"
    file.write_text(text)
    return file
