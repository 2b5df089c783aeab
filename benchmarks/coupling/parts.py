"""Builds the FMUs of the coupling problems from parts.c."""

from __future__ import annotations

import subprocess
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import fmpy

__all__ = ["ABILITIES", "MODELS", "Model", "build"]

SOURCE = Path(__file__).parent / "parts.c"


@dataclass(frozen=True)
class Model:
    """The interface of a part, in the order of its references.

    Parameters
    ----------
    inputs, outputs, parameters, states : tuple of str
        Of the states, the names of their start values.
    passes_on : tuple of str
        The outputs that follow at once from the inputs.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    states: tuple[str, ...]
    passes_on: tuple[str, ...] = ()


def _matrix(name: str, rows: int, columns: int) -> tuple[str, ...]:
    return tuple(f"{name}[{i},{j}]" for i in range(1, rows + 1) for j in range(1, columns + 1))


_LINEAR = (*_matrix("A", 4, 4), *_matrix("B", 4, 2), *_matrix("C", 2, 4), *_matrix("D", 2, 2))
_STATES = ("x0[1]", "x0[2]", "x0[3]", "x0[4]")

MODELS: Mapping[str, Model] = MappingProxyType(
    {
        "linear": Model(("u1", "u2"), ("y1", "y2"), _LINEAR, _STATES),
        # The same library; it differs in what the description says of its outputs.
        "linear_direct": Model(("u1", "u2"), ("y1", "y2"), _LINEAR, _STATES, ("y1", "y2")),
        "vanderpol": Model(("u",), ("y",), ("mu",), ("x0",)),
        "lorenz": Model(("u",), ("y1", "y2"), ("r", "b"), ("x0[1]", "x0[2]")),
        "species": Model(("u",), ("y",), ("a", "b"), ("x0",)),
        "tank": Model(("u",), ("y1", "y2"), ("c", "A"), ("x0",)),
        "activator": Model(("u",), ("y",), ("a", "b"), ("x0",)),
        "inhibitor": Model(("u",), ("y",), ("b",), ("x0",)),
        "phase": Model(("u1", "u2"), ("y",), ("w", "k"), ("x0",)),
        "pendulum": Model(("u",), ("y1", "y2"), ("g", "d"), ("x0[1]", "x0[2]")),
        "membrane": Model(("u",), ("y",), ("i",), ("x0",)),
        "hardening": Model(("u",), ("y",), ("k", "b"), (), ("y",)),
        "relay": Model(("u",), ("y",), ("low", "high", "band"), ("x0",), ("y",)),
    }
)

ABILITIES: Mapping[str, str] = MappingProxyType(
    {
        "fixed": "",
        "held": 'canHandleVariableCommunicationStepSize="true"',
        "state": 'canHandleVariableCommunicationStepSize="true" canGetAndSetFMUstate="true"',
        "full": 'canHandleVariableCommunicationStepSize="true" canGetAndSetFMUstate="true" '
        'canInterpolateInputs="true" maxOutputDerivativeOrder="1"',
    }
)
"""What FMUs declare: as most black boxes, steps of one length and held inputs alone; also steps of
any length; also states; everything."""


def build(folder: Path, abilities: Sequence[str] = tuple(ABILITIES)) -> None:
    """Write ``<model>_<ability>.fmu`` of all models into a folder.

    Raises
    ------
    subprocess.CalledProcessError
        Without a C compiler ``gcc``, or a source that it refuses.
    """
    library = folder / "parts.so"
    headers = Path(fmpy.__file__).parent / "c-code"
    subprocess.run(
        ["gcc", "-shared", "-fPIC", "-O2", f"-I{headers}", SOURCE, "-lm", "-o", library],
        check=True,
    )
    for name, model in MODELS.items():
        for ability in abilities:
            with zipfile.ZipFile(folder / f"{name}_{ability}.fmu", "w") as archive:
                archive.write(library, f"binaries/{fmpy.platform}/parts.so")
                description = _description(name, model, ability)
                archive.writestr("modelDescription.xml", description)


def _description(name: str, model: Model, ability: str) -> str:
    """modelDescription.xml of a part."""
    kinds = [
        *((n, 'causality="input" variability="continuous"', ' start="0"') for n in model.inputs),
        *((n, 'causality="output" variability="continuous"', "") for n in model.outputs),
        *(
            (n, 'causality="parameter" variability="fixed"', ' start="0"')
            for n in (*model.parameters, *model.states)
        ),
        ("inner", 'causality="parameter" variability="fixed"', ' start="1e-3" unit="s"'),
    ]
    variables = "".join(
        f'<ScalarVariable name="{variable}" valueReference="{k}" {causality}>'
        f"<Real{start}/></ScalarVariable>"
        for k, (variable, causality, start) in enumerate(kinds)
    )
    inputs = " ".join(str(1 + k) for k in range(len(model.inputs)))
    places = {output: 1 + len(model.inputs) + k for k, output in enumerate(model.outputs)}
    unknowns = "".join(
        f'<Unknown index="{place}" dependencies="{inputs if output in model.passes_on else ""}"/>'
        for output, place in places.items()
    )
    initial = "".join(f'<Unknown index="{place}"/>' for place in places.values())
    return (
        '<?xml version="1.0" encoding="UTF-8"?>'
        f'<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{name} {ability}">'
        f'<CoSimulation modelIdentifier="parts" {ABILITIES[ability]}/>'
        '<UnitDefinitions><Unit name="s"><BaseUnit s="1"/></Unit></UnitDefinitions>'
        f"<ModelVariables>{variables}</ModelVariables>"
        f"<ModelStructure><Outputs>{unknowns}</Outputs>"
        f"<InitialUnknowns>{initial}</InitialUnknowns></ModelStructure>"
        "</fmiModelDescription>"
    )
