"""A profile as a list of one-key tables, as read from TOML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .checks import ProfileError, boolean, check_keys, checked, finite, shown
from .kinds import BY_KIND, KINDS, body_of, parameters, scalar_term, table_of_file
from .table import Table
from .terms import Constant, Term

__all__ = ["spec_of_terms", "terms_of_spec"]


def terms_of_spec(spec: Any, where: str, base: str) -> tuple[Term, ...]:
    """The terms that a specification lists; cf. `Profile.from_spec`."""
    if finite(spec) == finite(spec):
        return (Constant(spec),)
    if not isinstance(spec, (list, tuple)):
        raise ProfileError(
            f"{where} = {shown(spec)}: must be a finite number or a list of terms, "
            "such as [{constant = -3.0}, {sine = {amplitude = 0.6, omega = 0.4}}]"
        )
    return tuple(_term(item, f"{where}[{k}]", base) for k, item in enumerate(spec, 1))


def spec_of_terms(terms: Sequence[Term]) -> list[dict[str, Any]]:
    """The specification that lists these terms."""
    return [{term.kind: body_of(term)} for term in terms]


def _term(item: Any, where: str, base: str) -> Term:
    """The term that one element of a specification describes."""
    if not isinstance(item, Mapping) or len(item) != 1:
        raise ProfileError(
            f"{where} = {shown(item)}: must be one term, such as {{constant = -3.0}}; "
            "terms: " + ", ".join(KINDS)
        )
    ((kind, body),) = item.items()
    check_keys(item, KINDS, where)
    where = f"{where}.{kind}"
    if kind == Constant.kind:
        checked(body, {"type": "Real", "positive": False}, where)
        return Constant(body)
    if not isinstance(body, Mapping):
        keys = ("file", "linear") if kind == Table.kind else tuple(parameters(BY_KIND[kind]))
        raise ProfileError(f"{where} = {shown(body)}: must be a table of " + ", ".join(keys))
    if kind != Table.kind:
        return scalar_term(kind, body, where)
    check_keys(body, ("times", "values", "file", "linear"), where)
    linear = boolean(body.get("linear", False), f"{where}.linear")
    if ("file" in body) == ("times" in body or "values" in body):
        raise ProfileError(f"{where}: give either file, or times and values")
    if "file" in body:
        return table_of_file(body["file"], linear, f"{where}.file", base)
    try:
        return Table(body.get("times", ()), body.get("values", ()), linear)
    except ProfileError as error:
        raise ProfileError(f"{where.rsplit('.', 1)[0]}.{error}") from None
