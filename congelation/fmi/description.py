"""What an FMU says of itself: modelDescription.xml as plain tables; no binary is loaded."""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import fmpy

from congelation.errors import InvalidInput, nearest

__all__ = ["Description", "Variable", "describe"]


@dataclass(frozen=True)
class Variable:
    """One scalar variable of an FMU.

    Parameters
    ----------
    name, type, causality, variability, initial
        As in the model description; `type` is Real, Integer, Boolean or String (an Enumeration
        is set and read as an Integer).
    reference : int
        Value reference.
    nominal : float
        Size at which a Real counts as of order one; 1 where the FMU does not say.
    unit : str
        Unit name, empty where the FMU does not say.
    """

    name: str
    reference: int
    type: str
    causality: str
    variability: str
    initial: str | None
    nominal: float = 1.0
    unit: str = ""

    @property
    def settable(self) -> bool:
        """Whether a start value may be given (FMI 2.0.4, section 2.2.7)."""
        return self.variability != "constant" and (
            self.causality in ("parameter", "input") or self.initial in ("exact", "approx")
        )


@dataclass(frozen=True)
class Description:
    """The part of a model description that a co-simulation master needs.

    Parameters
    ----------
    path : Path
        The .fmu file.
    sha256 : str
        Of the file's bytes.
    variables : mapping of str to Variable
        By name, in the order of the file.
    dependencies : mapping of str to (tuple of str or None)
        For each output, the variables on which it depends directly; None where the FMU does not
        say, which means all of them.
    """

    path: Path
    sha256: str
    model_identifier: str
    guid: str
    variables: Mapping[str, Variable]
    dependencies: Mapping[str, tuple[str, ...] | None]
    can_get_and_set_state: bool
    can_interpolate_inputs: bool
    can_vary_step: bool
    once_per_process: bool
    max_output_derivative_order: int

    def variable(self, name: str, place: str) -> Variable:
        """The variable `name`, or InvalidInput that names the nearest one."""
        if name not in self.variables:
            raise InvalidInput(
                f"{place}: {self.path.name} has no variable '{name}'; "
                f"{nearest(name, self.variables)}"
            )
        return self.variables[name]


def describe(path: Path) -> Description:
    """Read modelDescription.xml of one FMU.

    A file read before is not read again while its size and time of change stay the same.

    Raises
    ------
    InvalidInput
        The file is missing, is no FMU, or offers no FMI 2.0 co-simulation.
    """
    path = Path(path)
    if not path.is_file():
        raise InvalidInput(f"no FMU at {path}; run `python build_fmu.py`, or correct the path")
    status = path.stat()
    key = (os.path.abspath(path), status.st_mtime_ns, status.st_size)
    if key not in _DESCRIPTIONS:
        _DESCRIPTIONS[key] = _read(path)
    return _DESCRIPTIONS[key]


_DESCRIPTIONS: dict[tuple[str, int, int], Description] = {}


def _read(path: Path) -> Description:
    try:
        model = fmpy.read_model_description(os.fspath(path), validate=False)
    except (zipfile.BadZipFile, KeyError) as error:
        raise InvalidInput(f"{path} is not an FMU: {error}") from error
    except Exception as error:  # fmpy raises bare Exception for whatever it cannot read
        raise InvalidInput(f"{path}: unreadable modelDescription.xml: {error}") from error
    simulation = model.coSimulation
    if model.fmiVersion != "2.0" or simulation is None:
        raise InvalidInput(
            f"{path}: FMI {model.fmiVersion} without 2.0 co-simulation; "
            "an FMI 2.0 co-simulation FMU is needed"
        )
    return Description(
        path=path,
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        model_identifier=simulation.modelIdentifier,
        guid=model.guid,
        variables=MappingProxyType({v.name: _variable(v) for v in model.modelVariables}),
        dependencies=MappingProxyType({u.variable.name: _names(u) for u in model.outputs}),
        can_get_and_set_state=simulation.canGetAndSetFMUstate,
        can_interpolate_inputs=simulation.canInterpolateInputs,
        can_vary_step=simulation.canHandleVariableCommunicationStepSize,
        once_per_process=simulation.canBeInstantiatedOnlyOncePerProcess,
        max_output_derivative_order=simulation.maxOutputDerivativeOrder,
    )


def _variable(variable: fmpy.model_description.ModelVariable) -> Variable:
    return Variable(
        name=variable.name,
        reference=variable.valueReference,
        type="Integer" if variable.type == "Enumeration" else variable.type,
        causality=variable.causality,
        variability=variable.variability,
        initial=variable.initial,
        nominal=abs(float(variable.nominal or 1.0)) or 1.0,
        unit=variable.unit or "",
    )


def _names(unknown: fmpy.model_description.Unknown) -> tuple[str, ...] | None:
    if unknown.dependencies is None:
        return None
    return tuple(variable.name for variable in unknown.dependencies)
