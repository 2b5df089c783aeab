"""FMUs written in C, compiled for the tests."""

import subprocess
import zipfile
from pathlib import Path

import fmpy

SOURCES = Path(__file__).parent / "fmus"


def compile_fmu(path: Path, source: str | Path, description: str) -> Path:
    """An FMU at `path` of a C source, in fmus/ if nothing else is said, and a model description."""
    library = path.with_suffix(".so")
    headers = Path(fmpy.__file__).parent / "c-code"
    subprocess.run(
        [
            "gcc",
            "-shared",
            "-fPIC",
            "-O2",
            f"-I{headers}",
            f"-I{SOURCES}",
            SOURCES / source,
            "-lm",
            "-o",
            library,
        ],
        check=True,
    )
    identifier = Path(source).stem
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(library, f"binaries/{fmpy.platform}/{identifier}.so")
        archive.writestr("modelDescription.xml", description)
    return path


def plain_fmu(folder: Path, *, declares: bool = False, source: str | Path = "plain.c") -> Path:
    """x' = a x + b1 u1 + b2 u2, y = x + d1 u1 + d2 u2, with held inputs and without derivatives.

    `declares`: whether it says that y follows from no input at once (d1 = d2 = 0). `source`: a file
    that includes plain.c, under the name plain.c as well.
    """
    causalities = {"u1": "input", "u2": "input", "y": "output"}
    names = ("u1", "u2", "y", "a", "b1", "b2", "d1", "d2", "x0", "grain", "ends", "fault")
    variables = "".join(
        f'<ScalarVariable name="{name}" valueReference="{k}" '
        + (
            f'causality="{causalities[name]}">'
            if name in causalities
            else 'causality="parameter" variability="fixed">'
        )
        + ("<Real/>" if name == "y" else '<Real start="0"/>')
        + "</ScalarVariable>"
        for k, name in enumerate(names)
    )
    known = ' dependencies=""' if declares else ""
    return compile_fmu(
        folder / f"plain_{declares}.fmu",
        source,
        '<?xml version="1.0" encoding="UTF-8"?>'
        '<fmiModelDescription fmiVersion="2.0" modelName="plain" guid="{2}">'
        '<CoSimulation modelIdentifier="plain" canHandleVariableCommunicationStepSize="true"'
        ' canGetAndSetFMUstate="true"/>'
        f"<ModelVariables>{variables}</ModelVariables>"
        f'<ModelStructure><Outputs><Unknown index="3"{known}/></Outputs></ModelStructure>'
        "</fmiModelDescription>",
    )


def bouncing_fmu(folder: Path) -> Path:
    """x'' = -g - w x + b u, y = x + d u, of model exchange; see fmus/bouncing.c."""
    names = ("u", "y", "kicks", "g", "w", "b", "d", "e", "x0", "v0", "fault", "asks", "ends")
    parts = [
        '<ScalarVariable name="u" valueReference="0" causality="input"><Real start="0"/>',
        '<ScalarVariable name="y" valueReference="1" causality="output"><Real/>',
        '<ScalarVariable name="kicks" valueReference="2" causality="output" '
        'variability="discrete"><Real/>',
        *(
            f'<ScalarVariable name="{name}" valueReference="{k}" causality="parameter" '
            'variability="fixed"><Real start="0"/>'
            for k, name in enumerate(names[3:], 3)
        ),
        '<ScalarVariable name="x" valueReference="13" causality="local"><Real/>',
        '<ScalarVariable name="v" valueReference="14" causality="local"><Real/>',
        '<ScalarVariable name="der(x)" valueReference="15" causality="local">'
        '<Real derivative="14"/>',
        '<ScalarVariable name="der(v)" valueReference="16" causality="local">'
        '<Real derivative="15"/>',
    ]
    variables = "".join(f"{part}</ScalarVariable>" for part in parts)
    return compile_fmu(
        folder / "bouncing.fmu",
        "bouncing.c",
        '<?xml version="1.0" encoding="UTF-8"?>'
        '<fmiModelDescription fmiVersion="2.0" modelName="bouncing" guid="{3}" '
        'numberOfEventIndicators="1"><ModelExchange modelIdentifier="bouncing"/>'
        '<CoSimulation modelIdentifier="bouncing"/>'
        f"<ModelVariables>{variables}</ModelVariables><ModelStructure><Outputs>"
        '<Unknown index="2" dependencies="1"/><Unknown index="3" dependencies=""/></Outputs>'
        '<Derivatives><Unknown index="16"/><Unknown index="17"/></Derivatives>'
        "</ModelStructure></fmiModelDescription>",
    )
