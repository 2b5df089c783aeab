"""FMUs written in C, compiled for the tests."""

import subprocess
import zipfile
from collections.abc import Mapping, Sequence
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
    names = ("u1", "u2", "y", "a", "b1", "b2", "d1", "d2", "x0", "grain", "ends", "fault")
    known = ' dependencies=""' if declares else ""
    outputs = f'<Unknown index="3"{known}/>'
    return compile_fmu(
        folder / f"plain_{declares}.fmu",
        source,
        _described("plain", names, {"u1": "input", "u2": "input", "y": "output"}, outputs),
    )


def truck_fmu(folder: Path) -> Path:
    """One part of a quarter truck, which holds its input and solves itself to a tolerance."""
    names = ("force", "position", "velocity", "acceleration")
    causalities = {"in": "input", **dict.fromkeys(names, "output")}
    outputs = "".join(f'<Unknown index="{k}"/>' for k in (2, 3, 4, 5))
    described = _described("truck", (*causalities, "part"), causalities, outputs)
    return compile_fmu(folder / "truck.fmu", "truck.c", described)


def signals_fmu(folder: Path, *, fixed: bool = False) -> Path:
    """Signals of time, among them discrete ones, and an integrator of such; see signals.c.

    `fixed`: whether it takes steps of 0.5 s alone.
    """
    reals = {
        "u": 'causality="input"',
        "x": 'causality="output"',
        "s": 'causality="output"',
        "held": 'causality="output" variability="discrete"',
        "z": 'causality="output"',
        "der(z)": 'causality="output"',
        **dict.fromkeys(("a", "w", "fault"), 'causality="parameter" variability="fixed"'),
    }
    listed = [
        f'<ScalarVariable name="{name}" valueReference="{k}" {kind}>'
        + ("<Real/>" if "output" in kind else f'<Real start="{float(name == "w")}"/>')
        for k, (name, kind) in enumerate(reals.items())
    ]
    for name, number, kind, start in (
        ("switch", 0, "Boolean", ' start="false"'),
        ("on", 1, "Boolean", ""),
        ("level", 0, "Integer", ' start="0"'),
        ("count", 1, "Integer", ""),
    ):
        listed.append(
            f'<ScalarVariable name="{name}" valueReference="{number}" '
            f'causality="{"input" if start else "output"}" variability="discrete"><{kind}{start}/>'
        )
    variables = "".join(f"{variable}</ScalarVariable>" for variable in listed)
    outputs = "".join(f'<Unknown index="{k}" dependencies=""/>' for k in (2, 3, 4, 5, 6, 11, 13))
    length = "" if fixed else ' canHandleVariableCommunicationStepSize="true"'
    return compile_fmu(
        folder / f"signals_{fixed}.fmu",
        "signals.c",
        '<?xml version="1.0" encoding="UTF-8"?>'
        '<fmiModelDescription fmiVersion="2.0" modelName="signals" guid="{4}">'
        f'<CoSimulation modelIdentifier="signals" canGetAndSetFMUstate="true"{length}/>'
        f'<DefaultExperiment stepSize="0.5"/><ModelVariables>{variables}</ModelVariables>'
        f"<ModelStructure><Outputs>{outputs}</Outputs></ModelStructure></fmiModelDescription>",
    )


def early_fmu(folder: Path) -> Path:
    """y = 1 from the time `at` on, which it announces, or by `margin` earlier."""
    causalities = {"y": "output", "next_event": "output"}
    outputs = "".join(f'<Unknown index="{k}" dependencies=""/>' for k in (1, 2))
    described = _described("early", (*causalities, "at", "margin"), causalities, outputs)
    return compile_fmu(folder / "early.fmu", "early.c", described)


def _described(
    name: str, variables: Sequence[str], causalities: Mapping[str, str], outputs: str
) -> str:
    """The model description of an FMU that can save its state and has Real variables alone.

    What has no causality is a parameter; value references are places.
    """
    listed = "".join(
        f'<ScalarVariable name="{variable}" valueReference="{k}" '
        + (
            f'causality="{causalities[variable]}">'
            if variable in causalities
            else 'causality="parameter" variability="fixed">'
        )
        + ("<Real/>" if causalities.get(variable) == "output" else '<Real start="0"/>')
        + "</ScalarVariable>"
        for k, variable in enumerate(variables)
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>'
        f'<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{{2}}">'
        f'<CoSimulation modelIdentifier="{name}" canHandleVariableCommunicationStepSize="true"'
        ' canGetAndSetFMUstate="true"/>'
        f"<ModelVariables>{listed}</ModelVariables>"
        f"<ModelStructure><Outputs>{outputs}</Outputs></ModelStructure>"
        "</fmiModelDescription>"
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
