"""The sources of one FMU, written to a folder: shared code, generated code, documentation.

All FMUs of a process share one Python interpreter, where modules are found by name: two FMUs with
an equally named module would run each other's code. So the package of every FMU carries a hash of
all its sources in its name, and everything in it is imported by that name.
"""

from __future__ import annotations

import hashlib
import html
import json
import pprint
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from congelation import signals
from congelation.export.equations import equations_module
from congelation.export.forms import Structure
from congelation.export.interface import Interface, ScalarVariable, interface_of
from congelation.export.spec import BlockSpec, FmuSpec, Spec
from congelation.theory.model import Model

__all__ = ["Staged", "stage"]

# Hex digits of the hash in a package's name: 64 bits, so no two builds share one.
_DIGITS = 16

# The module that PythonFMU's library loads by name; all else is in the FMU's package.
_SLAVE = """\
from {package}.{module} import {base}

__all__ = ["{name}"]


class {name}({base}):
    \"\"\"{description}.\"\"\"

    # The library makes this class anew for every instance and never frees it, and each time it
    # drops a reference to this module's globals that it does not own. Two functions hold two:
    # with one, the globals are freed too early and the host can crash at its exit.
    def __init__(self, **kwargs):
        super().__init__(**kwargs)

    def __repr__(self):
        return f"<{{self.modelName}} {{self.instance_name}}>"
"""


@dataclass(frozen=True)
class Staged:
    """A staged FMU: where its files lie, under which names, with which variables."""

    name: str
    package: str
    digest: str
    slave: Path
    resources: tuple[Path, ...]
    about: Path
    documentation: Path
    icon: bytes
    interface: Interface


def stage(fmu: FmuSpec, spec: Spec | BlockSpec, sources: Path, folder: Path) -> Staged:
    """Write the sources of an FMU under `folder`.

    Parameters
    ----------
    fmu : FmuSpec
        One of those of `spec`.
    spec : Spec or BlockSpec
        Goes into the FMU as ``spec.json``, so that others can derive the same equations.
    sources : Path
        The folder fmu_src.
    folder : Path
        An empty folder.
    """
    interface = interface_of(fmu.model, fmu.profiles)
    equations = (sources / "equations" / f"{fmu.model.name}.html").read_text("utf-8")
    page = _page(fmu, spec, interface, equations)
    icon = (sources / f"{fmu.role}.png").read_bytes()
    about = json.dumps(_about(fmu, spec), indent=1, sort_keys=True) + "\n"

    # Every module of the FMU: the run time, the profiles of theta(t), what is generated.
    modules = {file.name: file.read_text("utf-8") for file in (sources / "python").glob("*.py")}
    for file in Path(signals.__file__).parent.glob("*.py"):
        modules[f"signals/{file.name}"] = file.read_text("utf-8")
    modules["equations.py"] = equations_module(fmu.model, fmu.special)
    modules["interface.py"] = _interface_module(fmu, interface)

    # The slave and the key of serialised states name the hash, so they cannot be part of it.
    digest = _digest({**modules, "slave.py": _SLAVE, "spec.json": about, "index.html": page})
    package = f"congelation_{digest[:_DIGITS]}"
    modules["interface.py"] += f"KEY = {f'{fmu.name} {digest}'!r}\n"
    for name, text in modules.items():
        file = folder / package / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, "utf-8")
    slave = folder / f"{package}_slave.py"
    slave.write_text(
        _SLAVE.format(
            package=package,
            module=fmu.run_time,
            base=fmu.run_time.capitalize(),
            name=fmu.model.name,
            description=fmu.model.description.replace("\\", "\\\\").replace('"', "'"),
        ),
        "utf-8",
    )
    spec_file = folder / "spec.json"
    spec_file.write_text(about, "utf-8")
    documentation = folder / "documentation"
    documentation.mkdir()
    (documentation / "index.html").write_text(page, "utf-8")
    return Staged(
        fmu.name,
        package,
        digest,
        slave,
        (folder / package, spec_file),
        spec_file,
        documentation,
        icon,
        interface,
    )


def _digest(texts: Mapping[str, str]) -> str:
    total = hashlib.sha256()
    for name, text in sorted(texts.items()):
        for part in (name, text):
            data = part.encode("utf-8")
            total.update(len(data).to_bytes(8, "big") + data)
    return total.hexdigest()


def _about(fmu: FmuSpec, spec: Spec | BlockSpec) -> dict[str, object]:
    about = {
        "title": spec.title,
        "form": spec.form,
        "structure": spec.structure,
        "role": fmu.role,
    }
    return {**about, **{other.role: other.name for other in spec.fmus}}


def _interface_module(fmu: FmuSpec, interface: Interface) -> str:
    """The table of variables as Python, for the slave at run time."""
    computed = (
        *interface.outputs,
        *interface.theta,
        *interface.next_event,
        *interface.derivatives,
        *interface.gains,
    )
    rows = [
        (v.name, v.type, v.causality, v.variability, v.initial, v.start, v.description)
        for v in interface.variables
    ]
    lines = [
        f'"""The table of variables of {fmu.name}. Generated by congelation."""',
        "",
        "from __future__ import annotations",
        "",
        "from collections import namedtuple",
        "",
        "# A variable's place in the table is its value reference.",
        "Variable = namedtuple(",
        '    "Variable", "name type causality variability initial start description"',
        ")",
        f"NAME = {fmu.name!r}",
        f"DESCRIPTION = {fmu.model.description!r}",
        "VARIABLES = tuple(",
        "    Variable(*row)",
        f"    for row in {pprint.pformat(rows, width=120, sort_dicts=False)}",
        ")",
        *(
            f"{name} = {pprint.pformat(value, width=100)}"
            for name, value in _layout(fmu.model, interface).items()
        ),
        f"COMPUTED = frozenset({sorted(computed)!r})",
    ]
    return "\n".join(lines) + "\n"


def _layout(model: Model, interface: Interface) -> dict[str, object]:
    """Which variables the equations take and return, by the names that the slave knows."""
    return {
        "INPUTS": interface.inputs,
        "PROPER_INPUTS": sum(len(i.variables.names) for i in model.inputs),
        "DTHETA_SLOTS": tuple(interface.inputs.index(vr) for vr in interface.dtheta),
        "OUTPUTS": interface.outputs,
        "THETA": interface.theta,
        "NEXT_EVENT": interface.next_event[0] if interface.next_event else None,
        # Of a block, time stands behind its signals in what the equations take.
        "TIMED": model.signals is not None,
        "DERIVATIVES": interface.derivatives,
        "GAINS": interface.gains,
        "STARTS": interface.starts,
        "PARAMETERS": tuple(
            (
                p.variables.name,
                p.domain.name,
                interface.parameters[p.variables.name],
                p.variables.shape[1],
                p.variables.indexed,
            )
            for p in model.parameters
        ),
        "RULES": tuple(
            (g.variables.name, g.rule, g.arguments, dict(g.constants)) for g in model.gains
        ),
        "PROFILES": tuple((n, tuple(f.items())) for n, f in interface.profiles.items()),
    }


_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>{name}</title>
<style>
body {{ font: 16px/1.5 sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; }}
table {{ border-collapse: collapse; font-size: 14px; display: block; overflow-x: auto; }}
th, td {{ border: 1px solid #bbb; padding: 0.2em 0.6em; text-align: left; }}
.equation {{ margin-left: 2em; }}
</style>
</head>
<body>
<h1>{name}</h1>
<p>{description}.{source}</p>
{equations}
{tables}
</body>
</html>
"""


_INPUTS = """<p>On a communication step [t, t + h] an input v acts as
v + der(v) s + der(v,2) s&sup2;/2 + der(v,3) s&sup3;/6, s being the time since t; left alone, the
derivatives are 0 and v is held.</p>"""

_SOURCE = """ Equation numbers are those of K. Chen and A. Astolfi, <i>Adaptive Control of
Linear Systems with Time-Varying Parameters</i>, American Control Conference 2018."""

_HEAD = "<tr><th>Name</th><th>Type</th><th>Start</th><th>Unit</th><th>Description</th></tr>"

_GROUPS: tuple[tuple[str, Callable[[ScalarVariable], bool]], ...] = (
    ("Inputs to connect", lambda v: v.causality == "input" and not v.open),
    (
        "Inputs to leave alone, unless their source is known",
        lambda v: v.causality == "input" and v.open,
    ),
    ("Outputs", lambda v: v.causality == "output"),
    (
        "Parameters",
        lambda v: v.causality == "parameter" and not v.name.startswith("profile["),
    ),
    ("Parameters of profiles", lambda v: v.name.startswith("profile[")),
    ("Computed from the parameters", lambda v: v.causality == "calculatedParameter"),
    ("Inner variables", lambda v: v.causality == "local"),
)
"""What a reader of the page looks for, in that order."""


def _page(fmu: FmuSpec, spec: Spec | BlockSpec, interface: Interface, equations: str) -> str:
    """documentation/index.html: the equations and the variables."""
    # A paragraph with data-with is kept where the FMU has all variables and options in it.
    has = {v.name.partition("[")[0] for v in interface.variables}
    has |= {f"{key}={value}" for key, value in spec.structure.items()}
    kept = [
        re.sub(' data-with="[^"]*"', "", line)
        for line in equations.strip().splitlines()
        if has.issuperset(" ".join(re.findall('data-with="([^"]*)"', line)).split())
    ]
    if fmu.role == "plant" and spec.form == "strict-feedback":
        kept += ["<p>With the functions of this plant:</p>", *_rows(spec.structure)]
    if any(v.causality == "input" for v in interface.variables):
        kept.append(_INPUTS)
    tables = []
    for title, belongs in _GROUPS:
        rows = "\n".join(
            "<tr>" + "".join(f"<td>{html.escape(str(cell))}</td>" for cell in cells) + "</tr>"
            for cells in (
                (v.name, v.type, "" if v.start is None else v.start, v.unit, v.description)
                for v in interface.variables
                if belongs(v)
            )
        )
        if rows:
            tables.append(f"<h2>{title}</h2>\n<table>\n{_HEAD}\n{rows}\n</table>")
    return _PAGE.format(
        name=html.escape(fmu.name),
        description=html.escape(
            fmu.model.description
            if fmu.role == "block"
            else f"{spec.title}. {fmu.model.description}"
        ),
        source="" if fmu.role == "block" else _SOURCE,
        equations="\n".join(kept),
        tables="\n".join(tables),
    )


def _rows(structure: Structure) -> Iterator[str]:
    """The equations (9) of a plant in strict-feedback form, with its regressors."""
    n, p = int(structure["n"]), int(structure["p"])
    control = f"&theta;<sub>{p + 1}</sub> u" if structure.get("gain") == "varying" else "u"
    for i in range(n):
        row = f"x<sub>{i + 1}</sub>&#8242; = "
        row += control if i == n - 1 else f"x<sub>{i + 2}</sub>"
        for k in range(p):
            if "phi" in structure:
                factors = [(1.0, f"({html.escape(structure['phi'][i][k])})")]
            else:
                factors = [(structure["phibar"][i][j][k], f"x<sub>{j + 1}</sub>") for j in range(n)]
            for number, factor in factors:
                if number != 0.0 and factor not in ("(0)", "(0.0)"):
                    sign = "&minus;" if number < 0 else "+"
                    size = "" if abs(number) == 1.0 else f"{abs(number):g} "
                    row += f" {sign} {size}&theta;<sub>{k + 1}</sub> {factor}"
        if structure.get("disturbance"):
            row += f" + d<sub>{i + 1}</sub>"
        yield f'<p class="equation">{row}</p>'
