"""Build the naive pair with pythonfmu's own command."""

from __future__ import annotations

from pathlib import Path

from pythonfmu.builder import FmuBuilder

from benchmarks.loop import Component, Loop

__all__ = ["naive_loop"]

SOURCES = Path(__file__).absolute().parent


def naive_loop(folder: Path) -> Loop:
    """Build both FMUs into `folder`, and connect them."""
    folder.mkdir(parents=True, exist_ok=True)
    components = []
    for name, file in (("plant", "naive_plant"), ("controller", "naive_controller")):
        FmuBuilder.build_FMU(SOURCES / f"{file}.py", dest=folder)
        fmu = next(
            path for path in folder.glob("*.fmu") if path.stem.lower() == file.replace("_", "")
        )
        components.append(Component(name, str(fmu)))
    return Loop(
        "naive",
        tuple(components),
        (
            ("plant", "x1", "controller", "x1"),
            ("plant", "x2", "controller", "x2"),
            ("controller", "u", "plant", "u"),
        ),
        (("plant", "x1"), ("plant", "x2"), ("controller", "u")),
    )
