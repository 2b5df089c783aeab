"""Variable names as the paper prints them: ``theta_hat[1]`` becomes theta hat with index 1."""

from __future__ import annotations

import re

__all__ = ["math_label", "plain_unit", "with_unit"]

_GREEK = re.compile(
    "alpha|beta|gamma|delta|epsilon|zeta|eta|theta|lambda|mu|nu|xi|rho|sigma|tau|phi|omega"
    "|Gamma|Delta|Theta|Lambda|Xi|Sigma|Phi|Omega"
)
_DERIVATIVE = re.compile(r"^der\((?P<name>.+)\)$")
# The exponent of a unit: 1/s2 as FMI writes it, or s^2.
_POWER = re.compile(r"(?<=[A-Za-z)])\^?\(?(-?\d+)\)?")
_VARIABLE = re.compile(r"^(?P<base>[A-Za-z]+)(?P<hat>_hat)?(?:\[(?P<index>\d+(?:,\d+)*)\])?$")


def math_label(variable: str) -> str:
    """The label of a variable, as Matplotlib mathtext; one that is no symbol stays as it is."""
    derivative = _DERIVATIVE.match(variable)
    match = _VARIABLE.match(derivative["name"] if derivative else variable)
    if match is None:
        return variable.replace("_", r"\_").replace("$", r"\$") if "$" in variable else variable
    symbol = _symbol(match["base"])
    if match["hat"]:
        symbol = rf"\hat{{{symbol}}}"
    if derivative:
        symbol = rf"\dot{{{symbol}}}"
    index = f"_{{{match['index']}}}" if match["index"] else ""
    return f"${symbol}{index}$"


def with_unit(label: str, unit: str) -> str:
    """``x [m]``; a dimensionless one has no brackets."""
    if unit in ("", "1"):
        return label
    return f"{label} [{_POWER.sub(_superscript, unit)}]"


def plain_unit(unit: str) -> str:
    """A unit for text: empty for a dimensionless one."""
    return "" if unit in ("", "1") else unit


def _superscript(power: re.Match[str]) -> str:
    return f"$^{{{power[1]}}}$"


def _symbol(base: str) -> str:
    if _GREEK.fullmatch(base):
        return rf"\{base}"
    return base if len(base) == 1 else rf"\mathrm{{{base}}}"
