"""The native twin of an FMU: the same variables and equations as C, compiled, without Python.

`model_source` writes the tables and equations of a model for the C layer in fmu_src/native;
`native_fmu` compiles both and takes modelDescription.xml and the documentation over from the
Python FMU, so that names, value references, defaults and dependencies are the same. Nothing of
the Python FMU is packed for that.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.etree import ElementTree

import fmpy

from congelation.errors import InvalidInput
from congelation.export.archive import write_archive
from congelation.export.equations import (
    Special,
    constants_of,
    equation_blocks,
    tangents_block,
)
from congelation.export.interface import Interface, StateVariable, state_variables
from congelation.export.model_description import add_model_exchange
from congelation.export.platforms import Platform, library
from congelation.export.spec import FmuSpec
from congelation.export.stage import Staged
from congelation.export.straight_line import c_functions
from congelation.signals import SLOTTED
from congelation.theory.model import Gain, Model

__all__ = ["model_source", "native_fmu"]

# The start of all GUIDs of native FMUs; it only has to stay the same, and to be another than that
# of the Python FMUs.
_NAMESPACE = uuid.UUID("6f0f1b3e-9f0e-5a52-8f6c-7d2d1c1f7a11")
_MODEL = "model.c"


def native_fmu(
    target: Path,
    fmu: FmuSpec,
    staged: Staged,
    description: bytes,
    sources: Path,
    platforms: Sequence[Platform],
) -> None:
    """Write the native twin of a Python FMU.

    Parameters
    ----------
    target : Path
        The file to write.
    fmu : FmuSpec
        What to build.
    staged : Staged
        The Python FMU's sources, from which documentation and icon are taken.
    description : bytes
        The Python FMU's modelDescription.xml.
    sources : Path
        The folder fmu_src.
    platforms : sequence of Platform
        What it is to run on.

    Raises
    ------
    InvalidInput
        The FMU has no native twin: it delays signals, or its profile is a table.
    CongelationError
        The compiler that is needed is not here, or it failed.
    """
    _check(fmu)
    about = staged.about.read_bytes()
    headers = Path(fmpy.__file__).parent / "c-code"
    layer = {
        file.name: file.read_bytes()
        for folder, pattern in ((headers, "fmi2*.h"), (sources / "native", "*.[ch]"))
        for file in sorted(folder.glob(pattern))
    }
    states = state_variables(fmu.model, fmu.profiles, staged.interface)
    body = model_source(fmu.model, fmu.special, staged.interface, states)
    key = hashlib.sha256(body.encode("utf-8"))
    for name, data in (*layer.items(), ("spec.json", about)):
        key.update(name.encode("utf-8") + len(data).to_bytes(8, "big") + data)
    guid = f"{{{uuid.uuid5(_NAMESPACE, fmu.name + key.hexdigest())}}}"
    identity = [
        f'const char MODEL_GUID[] = "{guid}";',
        f"const unsigned char MODEL_KEY[32] = {{{', '.join(map(str, key.digest()))}}};",
    ]
    model = (body + "\n".join(identity) + "\n").encode("utf-8")
    code = {**layer, _MODEL: model}
    files = [name for name in sorted(code) if name.endswith(".c")]
    xml, identifier = _description(description, guid, files, staged.interface, states)
    entries = {
        "documentation/index.html": (staged.documentation / "index.html").read_bytes(),
        "documentation/licenses/license.txt": (sources / "native" / "licenses.txt").read_bytes(),
        "model.png": staged.icon,
        "resources/spec.json": about,
        **{
            f"binaries/{p.folder}/{identifier}{p.extension}": library(fmu.name, layer, model, p)
            for p in platforms
        },
        **{f"sources/{name}": data for name, data in code.items()},
    }
    write_archive(target, [("modelDescription.xml", xml), *sorted(entries.items())])


def _check(fmu: FmuSpec) -> None:
    if fmu.run_time not in ("block", "driven"):
        raise InvalidInput(
            f"{fmu.name}: a {fmu.run_time} has no native FMU, as its memory grows while it steps; "
            "build it without --native"
        )
    for j, profile in enumerate(fmu.profiles, start=1):
        if profile.profile.to_flat(profile.slots).get("table.file", ""):
            raise InvalidInput(
                f"{fmu.name}: profile[{j}] is a table, which native FMUs do not read; build it "
                "without --native"
            )


# -- source ---------------------------------------------------------------------------------------


def model_source(
    model: Model, special: Special | None, interface: Interface, states: Sequence[StateVariable]
) -> str:
    """C source of a model: its tables of variables, gains and equations (see block.h)."""
    lines = [
        f"/* {model.description.replace('*/', '* /')}. Generated by congelation. */",
        "",
        "#include <math.h>",
        "#include <stdio.h>",
        "",
        '#include "block.h"',
        "",
        *_tables(model, interface, states),
        "",
        *_gains(model),
        "",
        *_equations(model, special),
        "",
    ]
    return "\n".join(lines)


def _tables(model: Model, interface: Interface, states: Sequence[StateVariable]) -> list[str]:
    roles: dict[int, tuple[str, int]] = {}
    for role, references in (
        ("INPUT", interface.inputs),
        ("OUTPUT", interface.outputs),
        ("DERIVATIVE", interface.derivatives),
        ("GAIN", interface.gains),
        ("THETA", interface.theta),
        ("NEXT_EVENT", interface.next_event),
    ):
        roles |= {vr: (role, index) for index, vr in enumerate(references)}
    constants = [vr for vr, v in enumerate(interface.variables) if v.causality == "parameter"]
    place = {vr: index for index, vr in enumerate(constants)}
    rows = []
    for vr, v in enumerate(interface.variables):
        role, index = roles.get(vr) or ("CONSTANT", place[vr])
        start = 0.0 if v.start is None or isinstance(v.start, str) else float(v.start)
        rows.append(f"{{\"{v.name}\", '{v.type[0]}', {role}, {index}, {start!r}}}")
    rows += [
        f"{{\"{s.derivative.name}\", 'R', RATE, {i}, 0.0}}"
        for i, s in enumerate(states)
        if s.derivative_reference >= len(interface.variables)
    ]
    parameters = [
        f'{{"{p.variables.name}", {p.domain.name}, {references[0]}, {len(references)}, '
        f"{p.variables.shape[1]}}}"
        for p in model.parameters
        for references in (interface.parameters[p.variables.name],)
    ]
    named = {interface.variables[vr].name: i for i, vr in enumerate(interface.outputs)}
    differentiated = [
        named[interface.variables[vr].name.removeprefix("der(").removesuffix(")")]
        for vr in interface.derivatives
    ]
    slots = [
        f'{{"{name}", {place[fields["mean"]]}, '
        + ", ".join(f"{n}, {first}" for n, first in _terms(fields, place))
        + "}"
        for name, fields in interface.profiles.items()
    ]
    inputs = sum(len(i.variables.names) for i in model.inputs)
    return [
        f"const int VARIABLE_COUNT = {len(rows)}, STATES = {len(states)}, INPUTS = {inputs};",
        f"const int OUTPUTS = {len(interface.outputs)}, DERIVATIVES = {len(differentiated)};",
        f"const int GAINS = {len(interface.gains)}, PROFILES = {len(slots)};",
        f"const int CONSTANTS = {len(constants)}, PARAMETERS = {len(parameters)};",
        f"const bool TIMED = {'true' if model.signals is not None else 'false'};",
        *_array("struct variable VARIABLES", rows),
        *_array("struct parameter MODEL_PARAMETERS", parameters or ['{"", REAL, 0, 0, 1}']),
        *_array("int START_CONSTANTS", [str(place[vr]) for vr in interface.starts] or ["0"]),
        *_array("int OUTPUT_OF_DERIVATIVE", [str(i) for i in differentiated] or ["-1"]),
        *_array("fmi2ValueReference STATE_REFERENCES", [str(s.reference) for s in states] or ["0"]),
        *_array("struct profile_slots PROFILE_SLOTS", slots or ["{0}"]),
    ]


def _array(declaration: str, rows: Iterable[str]) -> list[str]:
    return [f"const {declaration}[] = {{", *(f"    {row}," for row in rows), "};"]


def _terms(fields: dict[str, int] | object, place: dict[int, int]) -> Iterable[tuple[int, int]]:
    """The number of terms of each kind, and the constant of the first one's first field."""
    assert isinstance(fields, dict)
    for kind in SLOTTED:
        own = [vr for name, vr in fields.items() if name.startswith(f"{kind}[")]
        count = len({name.split("]")[0] for name in fields if name.startswith(f"{kind}[")})
        yield count, place[min(own)] if own else 0


def _gains(model: Model) -> list[str]:
    """``model_gains``: each rule called with the parameters that it takes."""
    offset, first = 0, {}
    sizes = {}
    for p in model.parameters:
        first[p.variables.name] = offset
        sizes[p.variables.name] = p.variables.shape[0]
        offset += len(p.variables.names)
    lines: list[str] = []
    calls: list[str] = []
    computed = 0
    for number, gain in enumerate(model.gains):
        orders = _orders(gain, sizes)
        matrices = [v for v in gain.constants.values() if not isinstance(v, int)]
        for k, value in enumerate(matrices):
            numbers = ", ".join(repr(float(x)) for row in _rows(value) for x in row)
            lines.append(f"static const double fixed{number}_{k}[] = {{{numbers}}};")
        fixed = ", ".join(f"fixed{number}_{k}" for k in range(len(matrices))) or "NULL"
        arguments = ", ".join(f"p + {first[name]}" for name in gain.arguments)
        calls += [
            "    {",
            f"        const double *arguments[] = {{{arguments}}}, *fixed[] = {{{fixed}}};",
            "        struct reason cause;",
            f"        outcome = rule_{gain.rule}({orders[0]}, {orders[1]}, arguments, fixed, "
            f"gains + {computed}, &cause);",
            "        if (outcome != COMPUTED) {",
            f'            explain(why, "{gain.variables.name}: %s", cause.text);',
            "            return outcome;",
            "        }",
            "    }",
        ]
        computed += len(gain.variables.names)
    return [
        *lines,
        "enum outcome model_gains(const double *p, double *gains, struct reason *why)",
        "{",
        "    enum outcome outcome = COMPUTED;",
        "    (void)p, (void)gains, (void)why;",
        *calls,
        "    return outcome;",
        "}",
    ]


def _orders(gain: Gain, sizes: dict[str, int]) -> tuple[int, int]:
    """Order of the equation behind a gain, and columns of B where it has one."""
    if "B" in gain.constants:
        B = _rows(gain.constants["B"])
        return len(B), len(B[0])
    if "n" in gain.constants:
        return int(str(gain.constants["n"])), 1
    return sizes[gain.arguments[0]], 1


def _rows(value: object) -> Sequence[Sequence[float]]:
    """A fixed matrix of a rule: nested tuples."""
    if not isinstance(value, Sequence):
        raise ValueError(f"a rule's constant {value!r} is no matrix")
    return value


def _equations(model: Model, special: Special | None) -> list[str]:
    general = constants_of(model)
    lines = c_functions("general", general, (*equation_blocks(model), tangents_block(model)))
    count = sum(len(p.variables.names) for p in model.parameters)
    simple: list[str] = []
    choice = "0"
    if special is not None:
        place = {name: i for i, (name, _) in enumerate(general)}
        taken = [place[name] for name, _ in constants_of(special.model)]
        lines += [
            "",
            *c_functions(
                "special",
                constants_of(special.model),
                (*equation_blocks(special.model), tangents_block(special.model)),
            ),
        ]
        choice = " && ".join(f"p[{place[name]}] == {v!r}" for name, v in special.values.items())
        simple = [
            f"    double q[{max(len(taken), 1)}];",
            *(f"    q[{i}] = p[{k}];" for i, k in enumerate(taken)),
            "    special_bind(q, &all->special);",
        ]
    lines += [
        "",
        "struct all {",
        "    int is_special;",
        "    struct general general;",
        *(["    struct special special;"] if special else []),
        "};",
        "const size_t BOUND_SIZE = sizeof(struct all);",
        "",
        "void model_bind(const double *parameters, const double *gains, void *bound)",
        "{",
        "    struct all *all = bound;",
        f"    double p[{max(len(general), 1)}] = {{0.0}};",
        "    (void)parameters, (void)gains;",
        f"    for (int i = 0; i < {count}; i++) p[i] = parameters[i];",
        f"    for (int i = {count}; i < {len(general)}; i++) p[i] = gains[i - {count}];",
        f"    all->is_special = {choice};",
        "    general_bind(p, &all->general);",
        *simple,
        "}",
    ]
    # Each takes the groups x, v, d, theta; the equations take d and theta where they need them.
    theta = ("theta",) if model.driven else ()
    for name, accepted, passed in (
        ("rates", ("x", "v", "theta"), ("x", "v", *theta)),
        ("outputs", ("x", "v", "theta"), ("x", "v", *theta)),
        ("derivatives", ("x", "v", "d", "theta"), ("x", "v", "d", *theta)),
        ("tangents", _TANGENT_ARGUMENTS, _TANGENT_ARGUMENTS),
    ):
        arguments = "".join(f", const double *{group}" for group in accepted)
        lines += [
            "",
            f"void model_{name}(const void *bound{arguments}, double *result)",
            "{",
            "    const struct all *all = bound;",
            "    (void)theta;",
        ]
        call = f"(&all->{{0}}, {', '.join(passed)}, result);"
        if special is not None:
            lines.append(
                f"    if (all->is_special) special_{name}{call.format('special')}\n    else"
            )
        lines += [f"    general_{name}{call.format('general')}", "}"]
    return lines


_TANGENT_ARGUMENTS = ("x", "v", "d", "theta", "x_seed", "v_seed", "d_seed", "theta_seed")


# -- description ----------------------------------------------------------------------------------


def _description(
    xml: bytes,
    guid: str,
    files: Sequence[str],
    interface: Interface,
    states: tuple[StateVariable, ...],
) -> tuple[bytes, str]:
    """modelDescription.xml of the native FMU, and its modelIdentifier, after which the library is
    named: the twin's with another GUID, source files and model exchange."""
    root = ElementTree.fromstring(xml)
    root.set("guid", guid)
    root.set("generationTool", str(root.get("generationTool")).split(" with ")[0] + " (native)")
    add_model_exchange(root, interface, states)
    identifier = ""
    for kind in (*root.iterfind("ModelExchange"), *root.iterfind("CoSimulation")):
        identifier = str(kind.get("modelIdentifier"))
        source_files = ElementTree.SubElement(kind, "SourceFiles")
        for file in files:
            ElementTree.SubElement(source_files, "File", {"name": file})
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text + b"\n", identifier
