"""What an FMU is to somebody who wants to connect it: read from the file, nothing is loaded."""

from __future__ import annotations

import json
import os
import re
import zipfile
from dataclasses import dataclass, field
from pathlib import Path

import fmpy

from congelation.errors import counted
from congelation.fmi.description import describe
from congelation.fmi.library import binaries_of, binary

__all__ = ["FmuInfo", "VariableInfo", "fmu_info"]

_ELEMENT = re.compile(r"\[\d+(,\d+)*\]$")


@dataclass(frozen=True)
class VariableInfo:
    """A variable, its unit, and the value that it has if nobody sets it.

    Attributes
    ----------
    name, type, unit : str
    start : str or None
    description : str
    least, most : float or None
        Its minimum and maximum.
    items : dict
        Of an enumeration: the value of each item, by its name.
    """

    name: str
    type: str
    unit: str
    start: str | None
    description: str
    least: float | None = None
    most: float | None = None
    items: dict[str, int] = field(default_factory=dict)

    @property
    def range(self) -> str:
        """What values it may have, as far as the FMU says; empty if it does not."""
        if self.items:
            return ", ".join(f"{name} = {value}" for name, value in self.items.items())
        if self.least is not None and self.most is not None:
            return f"from {self.least:g} to {self.most:g}"
        if self.least is not None:
            return f"at least {self.least:g}"
        return "" if self.most is None else f"at most {self.most:g}"


@dataclass(frozen=True)
class Design:
    """What an FMU of `congelation build` says of the spec that it was built from.

    Attributes
    ----------
    title, form : str
    role : str
        plant or controller.
    plant, controller : str
        The names of the two FMUs of the spec.
    order : int or None
        n, where the form has one.
    """

    title: str
    form: str
    role: str
    plant: str
    controller: str
    order: int | None = None


@dataclass(frozen=True)
class FmuInfo:
    """What an FMU is.

    Attributes
    ----------
    path : Path
    name, description, tool : str
        Of the model, and what wrote the FMU.
    connect : tuple of VariableInfo
        Inputs to connect.
    leave : tuple of VariableInfo
        Inputs that are optional: derivatives of other inputs, and disturbances that are added to a
        profile; left alone, they have no effect.
    outputs, parameters : tuple of VariableInfo
    stop_time, step : float or None
        The experiment that the FMU proposes, in seconds.
    saves_state : bool
        Whether steps can be taken back (canGetAndSetFMUstate).
    varies_step : bool
        Whether steps may be of different lengths.
    binaries : tuple of str
        The platforms and files that it can run on, ``linux64/Plant.so``.
    missing : str
        The binary that this machine needs and that it has not; empty where it can be run here.
    design : Design or None
        Of an FMU that `congelation build` wrote.
    """

    path: Path
    name: str
    description: str
    tool: str
    connect: tuple[VariableInfo, ...]
    leave: tuple[VariableInfo, ...]
    outputs: tuple[VariableInfo, ...]
    parameters: tuple[VariableInfo, ...]
    stop_time: float | None
    step: float | None
    saves_state: bool
    varies_step: bool
    binaries: tuple[str, ...] = ()
    missing: str = ""
    design: Design | None = None

    def __str__(self) -> str:
        abilities = [
            "steps of any length" if self.varies_step else "steps of one length only",
            "steps can be taken back" if self.saves_state else "steps cannot be taken back",
        ]
        lines = [
            f"{self.path.name}: {self.description or self.name}",
            f"  FMI 2.0 co-simulation, written by {self.tool or 'an unnamed tool'}; "
            + ", ".join(abilities),
        ]
        if self.tool.startswith("congelation") and "PythonFMU" in self.tool:
            lines.append(
                "  its host needs a Python 3.9 or newer; "
                "`congelation build SPEC --native` makes an FMU that does not"
            )
        if self.missing:
            held = ", ".join(self.binaries) or "none at all"
            lines.append(
                f"  it cannot be run here: it has no binary {self.missing}; there is {held}"
            )
        for title, group in (
            ("inputs to connect", self.connect),
            ("inputs to leave alone, unless their source is known (0: no effect)", self.leave),
            ("outputs", self.outputs),
            ("parameters", self.parameters),
        ):
            if group:
                lines += ["", f"  {title}", *_table(group)]
        return "\n".join(lines)


def fmu_info(path: Path) -> FmuInfo:
    """Read an FMU's model description.

    Raises
    ------
    InvalidInput
        The file is missing, is no FMU, or offers no FMI 2.0 co-simulation.
    """
    known = describe(path)
    model = fmpy.read_model_description(os.fspath(path), validate=False)
    experiment = model.defaultExperiment
    binaries, wanted = binaries_of(path), binary(known.model_identifier)

    def of(causality: str) -> list[VariableInfo]:
        return [
            VariableInfo(
                v.name,
                v.type,
                v.unit or "",
                v.start,
                v.description or "",
                known.variables[v.name].least,
                known.variables[v.name].most,
                dict(known.variables[v.name].items),
            )
            for v in model.modelVariables
            if v.causality == causality
        ]

    inputs = of("input")
    names = {v.name for v in inputs}
    optional = [v for v in inputs if v.name in known.open_inputs or _is_optional(v.name, names)]
    return FmuInfo(
        path=Path(path),
        name=model.modelName,
        description=model.description or "",
        tool=model.generationTool or "",
        connect=tuple(v for v in inputs if v not in optional),
        leave=tuple(optional),
        outputs=tuple(of("output")),
        parameters=tuple(of("parameter")),
        stop_time=_number(experiment.stopTime) if experiment else None,
        step=_number(experiment.stepSize) if experiment else None,
        saves_state=known.can_get_and_set_state,
        varies_step=known.can_vary_step,
        binaries=binaries,
        missing="" if wanted in binaries else wanted,
        design=_design(path),
    )


def _design(path: Path) -> Design | None:
    """What ``resources/spec.json`` says; None where there is none that can be read so."""
    with zipfile.ZipFile(path) as archive:
        if _SPEC not in archive.namelist():
            return None
        try:
            about = json.loads(archive.read(_SPEC))
            order = about["structure"].get("n")
            return Design(
                title=str(about["title"]),
                form=str(about["form"]),
                role=str(about["role"]),
                plant=str(about["plant"]),
                controller=str(about["controller"]),
                order=order if isinstance(order, int) else None,
            )
        except (ValueError, KeyError, TypeError, AttributeError):
            return None  # another tool's file of that name


_SPEC = "resources/spec.json"


def _is_optional(name: str, inputs: set[str]) -> bool:
    """Whether an input is der(v), der(v,2), .. of another input v, or dtheta[j] of a plant here."""
    derivative = re.fullmatch(r"der\((.+?)(,\d+)?\)", name)
    return (derivative is not None and derivative[1] in inputs) or name.startswith("dtheta[")


def _number(text: str | float | None) -> float | None:
    """What the model description states, where it is a number."""
    try:
        return None if text is None else float(text)
    except ValueError:
        return None


def _table(group: tuple[VariableInfo, ...]) -> list[str]:
    """One line for each scalar, vector and matrix; the parameters of a profile in one line."""
    merged: dict[str, list[VariableInfo]] = {}
    for v in group:
        # profile[1].sine[2].omega belongs to profile[1]; x[1], x[2] and der(x[1]) to x and der(x).
        head = v.name.split(".")[0]
        key = f"{head}.*" if head != v.name else _ELEMENT.sub("", v.name)
        merged.setdefault(key, []).append(v)
    rows = []
    for key, members in merged.items():
        if key.endswith(".*"):
            rows.append((key, "", "", counted(len(members), "parameter")))
            continue
        first, last = members[0], members[-1]
        name = first.name if first is last else f"{first.name} .. {last.name.removeprefix(key)}"
        units = [v.unit for v in members]
        units = units[:1] if len(set(units)) == 1 else [unit or "1" for unit in units]
        starts = [v.start for v in members if v.start is not None]
        # Equal values of a vector are said once.
        shown = starts[:1] if len(set(starts)) == 1 else starts
        ranges = list(dict.fromkeys(v.range for v in members))
        # "Start value of x[1]" is said of all of x.
        about = first.description if first is last else _ELEMENT.sub("", first.description)
        text = "; ".join(filter(None, (about, *ranges[: len(ranges) == 1])))
        rows.append((name, ", ".join(shown), ", ".join(filter(None, units)), text))
    widths = [min(34, max(len(row[k]) for row in rows)) for k in range(3)]
    return [
        "    "
        + "  ".join([*(c.ljust(w) for c, w in zip(row, widths, strict=False)), row[3]]).rstrip()
        for row in rows
    ]
