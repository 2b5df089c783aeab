"""What an FMU says of itself: modelDescription.xml as plain tables; no binary is loaded."""

from __future__ import annotations

import hashlib
import math
import os
import stat
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

import fmpy
from lxml import etree

from congelation.errors import InvalidInput, nearest
from congelation.fmi.document import check_references, read_document, schema_error
from congelation.fmi.units import BASE, Unit, is_rate, unit_named

__all__ = [
    "ANNOTATION",
    "EVENT",
    "Description",
    "Equations",
    "Variable",
    "derivative_name",
    "describe",
]


EVENT = "next_event"
"""Name of the output that announces the next jump."""

ANNOTATION = "congelation"
"""Name of the tool in annotations of FMUs."""


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
    items : tuple of (str, int)
        Of an enumeration, which is an Integer: its items, each with its value.
    nominal : float
        Size at which a Real counts as of order one; 1 where the FMU does not say.
    unit : str
        Unit name, empty where the FMU does not say.
    relative : bool
        Whether values are differences, to which the offset of a unit does not apply.
    description : str
        The FMU's own, empty where it has none.
    least, most : float or None
        The range of a number; None where the FMU does not bound it.
    default : str
        The start value as the FMU states it, empty where it states none.
    is_held : bool
        Whether the value is constant between events, rather than following the time.
    """

    name: str
    reference: int
    type: str
    causality: str
    variability: str
    initial: str | None
    nominal: float = 1.0
    items: tuple[tuple[str, int], ...] = ()
    unit: str = ""
    relative: bool = False
    description: str = ""
    least: float | None = None
    most: float | None = None
    default: str = ""
    is_held: bool = False

    @cached_property
    def settable(self) -> bool:
        """Whether a start value may be given (FMI 2.0.4, section 2.2.7)."""
        return self.variability != "constant" and (
            self.causality in ("parameter", "input") or self.initial in ("exact", "approx")
        )


@dataclass(frozen=True)
class Equations:
    """What an FMU offers as model exchange: its differential equations.

    Parameters
    ----------
    states, indicators : int
        How many continuous states and event indicators there are.
    completes : bool
        Whether fmi2CompletedIntegratorStep is to be called.
    """

    model_identifier: str
    states: int
    indicators: int
    completes: bool


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
    units : mapping of str to Unit
        Those that the FMU defines, the ones that it displays included.
    open_inputs : frozenset of str
        Inputs that the FMU says are meant to be left alone, by an annotation of this project.
    announces : bool
        Whether its outputs jump of themselves only when `next_event` has said so: it has such an
        output, or is of this project.
    proposed_step : float or None
        Communication step that the FMU proposes (DefaultExperiment), in seconds.
    equations : Equations or None
        None where the FMU offers no model exchange.
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
    units: Mapping[str, Unit] = field(default_factory=dict)
    open_inputs: frozenset[str] = frozenset()
    announces: bool = False
    proposed_step: float | None = None
    equations: Equations | None = None

    def unit(self, name: str) -> Unit | None:
        """The unit of a name, as the FMU defines it, else as is usual; None for no name."""
        if not name:
            return None
        found = self.units.get(name)
        return found if found is not None else unit_named(name)

    def derivative(self, variable: Variable, causality: str, order: int = 1) -> Variable | None:
        """The Real variable der(v), der(v,2), .. of a causality, where it is known and not in
        another unit than that of v per second."""
        found = self.variables.get(derivative_name(variable.name, order))
        if found is None or (found.causality, found.type) != (causality, "Real"):
            return None
        return None if self.misfit(variable, order) else found

    def misfit(self, variable: Variable, order: int = 1) -> str:
        """That der(v), der(v,2), .. is in another unit than that of v per second; else empty."""
        found = self.variables.get(derivative_name(variable.name, order))
        if found is None or is_rate(self.unit(found.unit), self.unit(variable.unit), order):
            return ""
        return (
            f"'{found.name}' is in '{found.unit}', which is not the unit of '{variable.name}' "
            f"('{variable.unit}') per second; it is not used"
        )

    @property
    def announcement(self) -> Variable | None:
        """The output that announces the next jump, in seconds."""
        found = self.variables.get(EVENT)
        if found is None or (found.causality, found.type) != ("output", "Real"):
            return None
        return found if found.unit in ("", "s") else None

    def variable(self, name: str, place: str) -> Variable:
        """The variable `name`, or InvalidInput that names the nearest one."""
        if name not in self.variables:
            raise InvalidInput(
                f"{place}: {self.path.name} has no variable '{name}'; "
                f"{nearest(name, self.variables)}"
            )
        return self.variables[name]


def derivative_name(name: str, order: int) -> str:
    """The name of the derivative variable of `order`: der(v), der(v,2), der(v,3)."""
    return f"der({name})" if order == 1 else f"der({name},{order})"


def describe(path: Path) -> Description:
    """Read modelDescription.xml of one FMU.

    A file read before is not read again while its size and time of change stay the same.

    Raises
    ------
    InvalidInput
        The file is missing, is no FMU, or offers no FMI 2.0 co-simulation.
    """
    name = os.path.abspath(path)
    try:
        status = os.stat(name)
    except (OSError, ValueError):
        status = None
    if status is not None and stat.S_ISDIR(status.st_mode):
        raise InvalidInput(f"{path}: this is a folder; give an FMU (.fmu)")
    if status is None or not stat.S_ISREG(status.st_mode):
        raise InvalidInput(
            f"no FMU at {path}; build it with: congelation build SPEC.toml; or correct the path"
        )
    key = (name, status.st_mtime_ns, status.st_size)
    if key not in _DESCRIPTIONS:
        _DESCRIPTIONS[key] = _read(Path(path))
    return _DESCRIPTIONS[key]


_DESCRIPTIONS: dict[tuple[str, int, int], Description] = {}


def _read(path: Path) -> Description:
    root = read_document(path)
    try:
        check_references(root)
        with open(path, "rb") as stream:
            model = fmpy.read_model_description(stream, validate=False)
        return _described(path, root, model)
    except InvalidInput:
        raise
    # fmpy raises bare Exception for whatever it cannot read; the schema says what and where it is.
    except Exception as error:
        reason = schema_error(root) or str(error)
        raise InvalidInput(f"{path}: unreadable modelDescription.xml: {reason}") from error


def _described(
    path: Path, root: etree._Element, model: fmpy.model_description.ModelDescription
) -> Description:
    simulation = model.coSimulation
    counts = Counter(variable.name for variable in model.modelVariables)
    if twice := [name for name, count in counts.items() if count > 1]:
        raise InvalidInput(
            f"{path}: modelDescription.xml has {counts[twice[0]]} variables named '{twice[0]}'; "
            "names must be unique (FMI 2.0, 2.2.7), see: congelation check --static"
        )
    own = f"VendorAnnotations/Tool[@name='{ANNOTATION}']"
    open_inputs = root.iterfind(f"{own}/OpenInputs/Input")
    relative = _relative_quantities(root)
    # Some tools declare everything as discrete, positions and speeds too, which says nothing.
    distinguishes = any(
        v.type == "Real" and v.causality == "output" and v.variability == "continuous"
        for v in model.modelVariables
    )
    return Description(
        path=path,
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        model_identifier=simulation.modelIdentifier,
        guid=model.guid,
        variables=MappingProxyType(
            {v.name: _variable(v, v.name in relative, distinguishes) for v in model.modelVariables}
        ),
        dependencies=MappingProxyType({u.variable.name: _names(u) for u in model.outputs}),
        can_get_and_set_state=simulation.canGetAndSetFMUstate,
        can_interpolate_inputs=simulation.canInterpolateInputs,
        can_vary_step=simulation.canHandleVariableCommunicationStepSize,
        once_per_process=simulation.canBeInstantiatedOnlyOncePerProcess,
        max_output_derivative_order=simulation.maxOutputDerivativeOrder,
        units=MappingProxyType(_units(model)),
        open_inputs=frozenset(element.get("name", "") for element in open_inputs),
        announces=EVENT in counts or root.find(own) is not None,
        proposed_step=_proposed_step(model),
        equations=_equations(model),
    )


def _equations(model: fmpy.model_description.ModelDescription) -> Equations | None:
    exchange = model.modelExchange
    # Its name becomes part of a path.
    if exchange is None or {*str(exchange.modelIdentifier)} & {"/", "\\", "\0"}:
        return None
    return Equations(
        model_identifier=exchange.modelIdentifier,
        states=len(model.derivatives),
        indicators=int(model.numberOfEventIndicators or 0),
        completes=not exchange.completedIntegratorStepNotNeeded,
    )


def _proposed_step(model: fmpy.model_description.ModelDescription) -> float | None:
    """The stepSize of DefaultExperiment, where it is one."""
    experiment = model.defaultExperiment
    try:
        step = float(experiment.stepSize) if experiment and experiment.stepSize else math.nan
    except ValueError:
        return None
    return step if math.isfinite(step) and step > 0.0 else None


def _units(model: fmpy.model_description.ModelDescription) -> dict[str, Unit]:
    """The UnitDefinitions; a display value is factor * v + offset of the unit's own values v."""
    found: dict[str, Unit] = {}
    counts = Counter(unit.name for unit in model.unitDefinitions)
    for unit in model.unitDefinitions:
        base = unit.baseUnit
        if base is None:
            continue
        exponents = tuple(int(getattr(base, symbol) or 0) for symbol in BASE)
        factor, offset = float(base.factor), float(base.offset)
        # No definition, or several: what has this unit cannot be compared.
        if not _converts(factor, offset) or counts[unit.name] > 1:
            found[unit.name] = Unit(unit.name)
            continue
        found[unit.name] = Unit(unit.name, exponents, factor, offset)
        for shown in unit.displayUnits:
            if not _converts(float(shown.factor), float(shown.offset)):
                continue
            scale = factor / float(shown.factor)
            shift = offset - scale * float(shown.offset)
            found.setdefault(shown.name, Unit(shown.name, exponents, scale, shift))
    return found


def _converts(factor: float, offset: float) -> bool:
    """Whether values can be converted both ways."""
    return factor != 0.0 and math.isfinite(factor) and math.isfinite(offset)


def _nominal(stated: str | None) -> float:
    """The size that errors of a variable are measured by: 1 where what is stated is none."""
    size = abs(float(stated or 1.0))
    return size if math.isfinite(size) and size > 0.0 else 1.0


def _relative_quantities(root: etree._Element) -> set[str]:
    """Names of the Reals that are differences, by themselves or by their type.

    FMPy looks for the attribute of a variable among its child elements, and finds none.
    """
    types = {
        kind.get("name"): real.get("relativeQuantity")
        for kind in root.iterfind("TypeDefinitions/SimpleType")
        for real in kind.iterfind("Real")
    }
    return {
        variable.get("name", "")
        for variable in root.iterfind("ModelVariables/ScalarVariable")
        for real in variable.iterfind("Real")
        if real.get("relativeQuantity", types.get(real.get("declaredType"))) in ("true", "1")
    }


def _bound(variable: fmpy.model_description.ModelVariable, name: str) -> float | None:
    """The least or the largest value of a number, by itself or by its type."""
    stated = getattr(variable, name) or getattr(variable.declaredType, name, None)
    return None if stated is None or variable.type == "Enumeration" else float(stated)


def _variable(
    variable: fmpy.model_description.ModelVariable, relative: bool, distinguishes: bool
) -> Variable:
    real = variable.type == "Real"
    return Variable(
        name=variable.name,
        reference=variable.valueReference,
        type="Integer" if variable.type == "Enumeration" else variable.type,
        causality=variable.causality,
        variability=variable.variability,
        initial=variable.initial,
        nominal=_nominal(variable.nominal),
        unit=variable.unit or (getattr(variable.declaredType, "unit", None) or ""),
        relative=relative,
        description=variable.description or "",
        least=_bound(variable, "min"),
        most=_bound(variable, "max"),
        default=str(variable.start or ""),
        is_held=not real or (distinguishes and variable.variability != "continuous"),
        items=tuple(
            (item.name, int(item.value))
            for item in getattr(variable.declaredType, "items", None) or ()
        ),
    )


def _names(unknown: fmpy.model_description.Unknown) -> tuple[str, ...] | None:
    if unknown.dependencies is None:
        return None
    return tuple(variable.name for variable in unknown.dependencies)
