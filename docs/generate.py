"""The pages of the reference that follow from the code: written before each build.

They go to `generated/`, which is not in the repository: what they say stands in the table of keys,
in the command line's own help, in the units and in the built FMUs.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator, Sequence
from enum import Enum, EnumType
from pathlib import Path
from zipfile import ZipFile

import typer
from lxml import html

import congelation as cg
from congelation.cli import app
from congelation.cli.shared import EXIT_CODES
from congelation.fmi.units import BASE, Unit, known_units
from congelation.keys import SCENARIO, SPEC, json_schema
from congelation.toml import Key, Table

__all__ = ["write_notebooks", "write_reference"]

ROOT = Path(__file__).parent.parent


def write_reference(folder: Path) -> None:
    """Write all generated pages into a folder, anew."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "fmus").mkdir(parents=True)
    (folder / "files" / "schemas").mkdir(parents=True)
    pages = {
        "commands.md": commands(),
        "scenario_keys.md": keys(SCENARIO, "a scenario"),
        "spec_keys.md": keys(SPEC, "a spec"),
        "units.md": units(),
        "python.md": python(),
    }
    fmus = sorted((ROOT / "fmus").glob("*.fmu"))
    if not fmus:
        raise FileNotFoundError("fmus/ holds no FMU; the reference describes them: make fmus")
    for path in fmus:
        pages[f"fmus/{path.stem}.md"] = fmu(path)
    pages["fmus.md"] = fmu_index(fmus)
    for name, lines in pages.items():
        (folder / name).write_text("\n".join(lines) + "\n", "utf-8")
    for title, table in (("scenario", SCENARIO), ("spec", SPEC)):
        text = json_schema(table, f"congelation {title}")
        (folder / "files" / "schemas" / f"{title}.json").write_text(text, "utf-8")


def write_notebooks(folder: Path) -> None:
    """Write each tutorial that has code cells as a Jupyter notebook, too, to be downloaded."""
    import jupytext

    target = folder / "generated" / "files" / "notebooks"
    target.mkdir(parents=True, exist_ok=True)
    for page in sorted((folder / "tutorials").glob("*.md")):
        if "{code-cell}" in page.read_text("utf-8"):
            jupytext.write(jupytext.read(page, fmt="md:myst"), target / f"{page.stem}.ipynb")


def cell(text: object) -> str:
    """A text as the cell of a table; ``--option`` in it is no dash."""
    text = re.sub(r"(?<![`\w])--\w[\w-]*", r"`\g<0>`", str(text))
    return str(text).replace("|", "\\|").replace("\n", " ").replace("<", "&lt;")


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    """A table of the columns that say something: on a phone there is room for few."""
    shown = [k for k in range(len(head)) if any(row[k] != "" for row in rows)]
    return [
        "| " + " | ".join(head[k] for k in shown) + " |",
        "|" + "---|" * len(shown),
        *("| " + " | ".join(cell(row[k]) for k in shown) + " |" for row in rows),
        "",
    ]


def commands() -> list[str]:
    """Every command with its arguments and options, in the words of its own help."""
    lines = [
        "# Commands",
        "",
        "`congelation COMMAND --help` says the same. An error that the user can correct is one "
        "line on standard error.",
        "",
        *table(["exit code", "meaning"], list(EXIT_CODES.items())),
    ]
    for name, command in typer.main.get_command(app).commands.items():  # type: ignore[attr-defined]
        arguments = [p for p in command.params if p.param_type_name == "argument"]
        options = [p for p in command.params if p.param_type_name == "option" and not p.hidden]
        usage = " ".join(_argument(p) for p in arguments)
        text = re.sub(r"\s*\n(?=\S)", " ", command.help or "")
        lines += [f"## {name}", "", f"    congelation {name} {usage}".rstrip(), "", text, ""]
        rows = [(f"`{_argument(p)}`", p.help or "", "") for p in arguments]
        rows += [(_option(p), p.help or "", _default(p)) for p in options]
        if rows:
            lines += table(["argument or option", "what it is", "default"], rows)
    return lines


def _argument(parameter: typer.core.TyperArgument) -> str:
    name = (parameter.metavar or parameter.name.upper()).strip("[].")
    name += "..." if parameter.nargs == -1 else ""
    return name if parameter.required else f"[{name}]"


def _option(parameter: typer.core.TyperOption) -> str:
    names = ", ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))
    if parameter.is_flag:
        return names
    return f"{names} `{parameter.metavar or parameter.name.upper()}`"


def _default(parameter: typer.core.TyperOption) -> str:
    shown = parameter.show_default
    if isinstance(shown, str):
        return shown
    if parameter.default is None or parameter.is_flag or not shown or callable(parameter.default):
        return ""
    value = parameter.default
    return f"`{value.value if isinstance(value, Enum) else value}`"


def keys(root: Table, what: str) -> list[str]:
    """Every table of a TOML file with its keys, from the table that the loaders read them by."""
    lines = [
        f"# Keys of {what}",
        "",
        f"{root.text} Unknown keys are errors. A time is a number of seconds, or a table as in "
        '`{value = 5, unit = "ms"}`.',
        "",
    ]
    seen: list[Table] = []  # the terms of a profile are those of a plant and of a block
    for name, found in _tables(root, ""):
        if any(found is other for other in seen):
            continue
        seen.append(found)
        lines += [f"## {name or 'The file'}", "", found.text, ""]
        rows = [_key(key) for key in (*found.keys, *((found.extra,) if found.extra else ()))]
        lines += table(["key", "value", "default", "what it is"], rows)
    return lines


def _key(key: Key) -> tuple[str, str, str, str]:
    if key.required:
        default = "required"
    elif key.default in (None, ()):
        default = ""
    else:
        default = f"`{json.dumps(key.default)}`"
    return f"`{key.name}`", key.valid + (f", {key.unit}" if key.unit else ""), default, key.text


def _tables(found: Table, path: str) -> Iterator[tuple[str, Table]]:
    """A table and those inside it that have keys of their own, with the headings of TOML."""
    if path.endswith((".start", ".set", ".options", ".units", ".phibar")) and not found.keys:
        return  # names of variables: the text of the key says all
    yield path, found
    for key in (*found.keys, *((found.extra,) if found.extra else ())):
        if key.table is None:
            continue
        inner = f"{path}.{key.name}" if path else key.name
        if key.kind == "tables":
            inner = f"[{inner}]"
        if key.kind == "terms":
            inner = "Terms of a profile"
        yield from _tables(key.table, inner)


def units() -> list[str]:
    """The grammar of units and the names in it."""
    rows = [
        (f"`{name}`", f"{unit.factor:.12g}", f"{unit.offset:g}" if unit.offset else "", _base(unit))
        for name, unit in known_units().items()
    ]
    return [
        "# Units",
        "",
        "A unit is a product: names from the table below, joined by `.`, each with an exponent if "
        "that is not 1; every name after a `/` is divided by: `m/s2`, `N.m`, `kg.m2/s3`, `1/s`. "
        "A value v in a unit is factor × v + offset in SI base units, as in FMI 2.0. "
        "Temperatures with an offset stand alone.",
        "",
        *table(["name", "factor", "offset", "in base units"], rows),
    ]


def _base(unit: Unit) -> str:
    """A unit's base units, written as a unit."""
    factors = [
        symbol if power == 1 else f"{symbol}{power}"
        for symbol, power in zip(BASE, unit.exponents or (), strict=False)
        if power
    ]
    return ".".join(factors) or "1"


def python() -> list[str]:
    """The public names, each with its docstring."""
    lines = [
        "# Python: every name",
        "",
        "What is here is public; how the names work together, with examples that are run, is in "
        "[The Python interface](../api.md).",
        "",
    ]
    for name in cg.__all__:
        if name.startswith("__"):
            continue
        kind = "autoclass" if isinstance(getattr(cg, name), type) else "autofunction"
        lines += [f"## {name}", "", "```{eval-rst}", f".. {kind}:: congelation.{name}"]
        if kind == "autoclass":
            lines += ["   :members:"]
        lines += ["```", ""]
        if isinstance(getattr(cg, name), EnumType):
            rows = [(f"`{member.name}`", member.value) for member in getattr(cg, name)]
            lines += table(["name", "value"], rows)
    return lines


def fmu(path: Path) -> list[str]:
    """What an FMU is, its equations, and its variables."""
    found = cg.info(path)
    model = found.fmus[0]
    lines = [
        "---",
        "orphan: true",
        "---",
        f"# {path.stem}",
        "",
        "```{raw} html",
        *equations(path),
        "```",
        "",
        "All FMUs of the project are in [The FMUs, one by one](../fmus.md).",
        "",
    ]
    groups = (
        ("Inputs to connect", model.connect),
        ("Inputs to leave alone, unless their source is known", model.leave),
        ("Outputs", model.outputs),
        ("Parameters", [v for v in model.parameters if not v.name.startswith("profile[")]),
    )
    for title, variables in groups:
        if not variables:
            continue
        rows = [
            (
                f"`{v.name}`",
                v.unit,
                "" if v.start is None else _start(v.start),
                v.description + (f" ({v.type})" if v.type != "Real" else ""),  # most are Real
            )
            for v in variables
        ]
        lines += [f"## {title}", "", *table(["name", "unit", "start", "what it is"], rows)]
    if any(v.name.startswith("profile[") for v in model.parameters):
        lines += [
            "The parameters `profile[j].…`, not listed here, describe the j-th signal that the FMU "
            "makes by itself, such as θ_j(t): [The parameter signals](../../signals.md).",
            "",
        ]
    return lines


def _start(value: object) -> str:
    """A start value, numbers to six digits."""
    try:
        return f"{float(str(value)):.6g}"
    except ValueError:  # true, a text
        return str(value)


def equations(path: Path) -> Iterator[str]:
    """What the FMU's own page says before its tables: what it is, and its equations."""
    with ZipFile(path) as archive:
        page = html.document_fromstring(archive.read("documentation/index.html").decode())
    for element in page.find("body"):
        if element.tag == "h2":
            return
        if element.tag != "h1":
            yield html.tostring(element, encoding="unicode").strip()


def fmu_index(paths: Sequence[Path]) -> list[str]:
    """A table of all FMUs, each with a link to its page.

    The pages stand in no table of contents: forty more entries in the navigation of every page
    would take a third of the time of the build, and bury the others.
    """
    rows = [(f"[{path.stem}](fmus/{path.stem}.md)", _description(path)) for path in paths]
    return [
        "# The FMUs, one by one",
        "",
        "Those that `make fmus` builds: the paper's examples, plants with cited numbers, and "
        "blocks to put between them. For an FMU of your own `congelation info FILE.fmu` prints the "
        "same.",
        "",
        *table(["FMU", "what it is"], rows),
    ]


def _description(path: Path) -> str:
    """The title of an FMU's spec and what the FMU itself is: what its own page says at first."""
    first = html.fromstring(next(equations(path))).text_content()
    return " ".join(first.split()).partition(" Equation numbers")[0]
