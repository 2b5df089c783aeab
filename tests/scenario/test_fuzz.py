"""Whatever stands in a scenario or a spec, it is read or refused in one line."""

from __future__ import annotations

import copy
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from congelation.errors import InvalidInput
from congelation.export.spec import read_spec
from congelation.scenario.load import load_scenario
from congelation.scenario.scenario import Scenario
from congelation.toml import Section
from tests.scenarios import ROOT, SCALAR

SWEEP = """
[sweep]
sampling = "sobol"
samples = 4
seed = 7
replicates = 2
reseed = ["plant.profile[1].telegraph[1].seed"]
constraints = ["controller.epsilon <= 2 * controller.gamma"]
timeout = {value = 1, unit = "min"}

[[sweep.axes]]
set = "controller.epsilon"
log_uniform = [0.1, 1.0]

[[sweep.axes]]
set = ["controller.gamma", "experiment.step"]
values = [[1.0, 0.01], [2.0, 0.02]]
"""
TEXT = SCALAR + SWEEP
SPEC = (ROOT / "specs" / "state_feedback.toml").read_text(encoding="utf-8")

NUMBERS = st.one_of(
    st.sampled_from([0, -1, 1, 2, 10**9, 2**63, 10**400, 0.0, -0.0, 1e-320, 1e308]),
    st.floats(),
    st.integers(),
)
TEXTS = st.one_of(
    st.sampled_from(
        ["", " ", "plant.x", "plant.x -> controller.x", "plant", "a.b", "->", "|plant.x|", "1 < 2"]
    ),
    st.text(max_size=12),
)
VALUES = st.recursive(
    st.one_of(st.booleans(), NUMBERS, TEXTS),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(
            st.one_of(st.sampled_from(["value", "unit", "fmu", "start", "set", "sine"]), TEXTS),
            inner,
            max_size=3,
        ),
    ),
    max_leaves=6,
)


def places(table: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The paths of all keys and entries."""
    if isinstance(table, dict):
        inner = list(table.items())
    else:
        inner = list(enumerate(table)) if isinstance(table, list) else []
    return [p for key, value in inner for p in ((*path, key), *places(value, (*path, key)))]


def mutated(document: dict[str, Any], data: st.DataObject) -> dict[str, Any]:
    """The document with one to three keys replaced, removed, renamed or added."""
    document = copy.deepcopy(document)
    for _ in range(data.draw(st.integers(1, 3))):
        found = places(document)
        if not found:
            break
        *path, key = data.draw(st.sampled_from(found))
        table: Any = document
        for step in path:
            table = table[step]
        action = data.draw(st.sampled_from(["replace", "remove", "rename", "copy"]))
        if action == "replace":
            table[key] = data.draw(VALUES)
        elif action == "remove":
            del table[key]
        elif isinstance(table, dict):
            value = table.pop(key) if action == "rename" else table[key]
            table[data.draw(st.one_of(st.just(f"{key}x"), TEXTS))] = value
        else:
            table.append(copy.deepcopy(table[key]))
    return document


def cut(text: str, data: st.DataObject) -> str:
    """The text with some of it left out, or replaced by other bits of it."""
    for _ in range(data.draw(st.integers(1, 3))):
        first = data.draw(st.integers(0, len(text)))
        last = data.draw(st.integers(first, min(len(text), first + 40)))
        other = data.draw(st.integers(0, len(text)))
        bit = data.draw(st.one_of(st.just(""), TEXTS, st.just(text[other : other + 20])))
        text = text[:first] + bit + text[last:]
    return text


def one_line(error: InvalidInput, file: Path | str) -> None:
    assert str(error).startswith(f"{file}: ")
    assert not {*"\n\r\v\f\x1c\x1d\x1e\x85\u2028\u2029"} & {*str(error)}


@settings(max_examples=400)
@given(st.data())
def test_a_mutated_scenario_is_read_or_refused(data: st.DataObject) -> None:
    document = mutated(tomllib.loads(TEXT), data)
    try:
        Scenario.from_document(Section("loop.toml", "", document), Path("loop.toml"), "")
    except InvalidInput as error:
        one_line(error, "loop.toml")


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_damaged_file_is_read_or_refused(tmp_path: Path, data: st.DataObject) -> None:
    file = tmp_path / "loop.toml"
    file.write_text(cut(TEXT, data), encoding="utf-8", errors="surrogatepass")
    try:
        load_scenario(file)
    except InvalidInput as error:
        one_line(error, file)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_damaged_spec_is_read_or_refused(tmp_path: Path, data: st.DataObject) -> None:
    file = tmp_path / "spec.toml"
    file.write_text(cut(SPEC, data), encoding="utf-8", errors="surrogatepass")
    try:
        read_spec(file)
    except InvalidInput as error:
        one_line(error, file)


@pytest.mark.parametrize("text", [SCALAR, SPEC], ids=["scenario", "spec"])
def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path, text: str) -> None:
    file = tmp_path / "marked.toml"
    file.write_text(text, encoding="utf-8-sig")
    assert file.read_bytes().startswith(b"\xef\xbb\xbf")
    if text is SCALAR:
        assert load_scenario(file).text == text
    else:
        assert read_spec(file).form == "strict-feedback"
