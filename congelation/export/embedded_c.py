"""The bare controller of a spec as C for sampled control: one function, no allocation, fixed cost.

The equations are those of the FMU, from the same expression graph, with the numbers of the spec in
place of parameters and gains. The integrator is another one: the classical Runge-Kutta method with
fixed steps, whose cost is the same in every sample.
"""

from __future__ import annotations

import importlib.resources
import re
from dataclasses import replace
from pathlib import Path

import casadi as ca

from congelation.export.equations import constants_of, equation_blocks
from congelation.export.spec import FmuSpec
from congelation.export.straight_line import Block, c_function, operations
from congelation.places import write_whole
from congelation.theory.values import complete_values

__all__ = ["controller_code"]

SUBSTEPS = 4
"""Runge-Kutta steps in each sample, where the compiler is not told another number."""


def controller_code(fmu: FmuSpec, folder: Path) -> list[Path]:
    """Write ``controller.h``, ``controller.c`` and an example ``main.c``.

    Parameters
    ----------
    fmu : FmuSpec
        A controller; the defaults of its parameters and start values are what the code holds.
    folder : Path
        Made if it is not there.

    Returns
    -------
    list of Path
        The three files.

    Raises
    ------
    InvalidInput, InfeasibleDesign
        A gain cannot be computed from the parameters.
    """
    texts = _texts(fmu)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / name for name in texts]
    for path, text in zip(paths, texts.values(), strict=True):
        write_whole(path, text)
    return paths


def _texts(fmu: FmuSpec) -> dict[str, str]:
    """The three files by name."""
    model = fmu.model
    # The numbers of parameters and gains, element by element, as `constants_of` lists them.
    groups = [p.variables for p in model.parameters] + [g.variables for g in model.gains]
    complete = complete_values(model)
    numbers = [float(x) for group in groups for x in complete[group.name].ravel()]
    known = {name: number for (name, _), number in zip(constants_of(model), numbers, strict=True)}
    # The simpler equations, where the settings of the adaptation law are neutral.
    simple = fmu.special
    if simple is not None and all(known[k] == float(v) for k, v in simple.values.items()):
        model = simple.model
    symbols = [symbol for _, symbol in constants_of(model)]
    values = [known[name] for name, _ in constants_of(model)]

    def numeric(block: Block) -> Block:
        results = ca.vertcat(*block.results)
        results = ca.substitute(results, ca.vertcat(*symbols), ca.vertcat(*values))
        arguments = tuple(
            (new, group) for (_, group), new in zip(block.arguments, ("x", "y"), strict=True)
        )
        return replace(block, arguments=arguments, results=tuple(ca.vertsplit(results)))

    rates, outputs = (numeric(block) for block in [*equation_blocks(model)][:2])
    control = replace(outputs, name="control", results=outputs.results[:1], doc="The control u.")
    name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", fmu.name).lower()
    inputs = [
        (element, unit)
        for i in model.inputs
        for element, unit in zip(i.variables.names, i.variables.units, strict=True)
    ]
    states = [
        (element, unit, start)
        for s in fmu.model.states
        for element, unit, start in zip(s.variables.names, s.variables.units, s.start, strict=True)
    ]
    words = {
        "name": name,
        "NAME": name.upper(),
        "title": model.description,
        "inputs": str(len(inputs)),
        "states": str(len(states)),
        "input_list": _listed("y", inputs),
        "state_list": _listed("x", [(element, unit) for element, unit, _ in states]),
        "parameters": "\n".join(f"     {k} = {v:.9g}" for k, v in known.items()),
        "substeps": str(SUBSTEPS),
        "cost": _cost(control, rates, len(states)),
        "equations": "\n".join([*c_function(control), "", *c_function(rates)]),
        "starts": "\n".join(
            f"    c->x[{i}] = {float(start)!r}; /* {element} */"
            for i, (element, _, start) in enumerate(states)
        ),
    }
    templates = importlib.resources.files("congelation.export") / "embedded"
    return {
        file: re.sub(
            r"@(\w+)@", lambda found: words[found[1]], (templates / file).read_text("utf-8")
        )
        for file in ("controller.h", "controller.c", "main.c")
    }


def _listed(array: str, names: list[tuple[str, str]]) -> str:
    return "\n".join(
        f"     {array}[{i}]  {name}{f' in {unit}' if unit else ''}"
        for i, (name, unit) in enumerate(names)
    )


def _cost(control: Block, rates: Block, n: int) -> str:
    """The operations of one sample, for the comment in the header."""
    lines = []
    for what, block in (("u", control), ("the rates of the states", rates)):
        sums, slow, called = operations(block)
        lines.append(
            f"     {what}: {sums} sums, products and comparisons, {slow} divisions and roots, "
            f"{called} functions"
        )
    # Of each component: four points of 3 operations, four terms of 2, and the step of 2.
    lines.append(
        f"     a sample: u once, and in each substep the rates four times and {22 * n} further "
        "sums\n     and products"
    )
    return "\n".join(lines)
