"""Sections of TOML files: every complaint names the file, the path and what would be valid."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from congelation.errors import InvalidInput
from congelation.toml import Section, parse_document, read_document

TEXT = """
title = "A title"
blank = " "
number = 3
flag = true
huge = inf
names = ["a", "b"]
mixed = ["a", 1]
vast = 1{zeros}
large = 9223372036854775808
never = {value = 1e308, unit = "h"}
time = {value = 20, unit = "ms"}
year = {value = 1, unit = "sec"}
half = {value = 1}
[table]
key = -1.5
[[list]]
name = "first"
[[list]]
nmae = "second"
""".replace("{zeros}", "0" * 400)


@pytest.fixture
def document() -> Section:
    return parse_document(TEXT, "a.toml")


def test_values_are_read(document: Section) -> None:
    assert document.as_kind("title", "text") == "A title"
    assert document.as_kind("number", "number") == 3.0
    assert isinstance(document.as_kind("number", "number"), float)
    assert document.as_kind("names", "texts") == ("a", "b")
    assert document.as_kind("number", "time") == 3.0
    assert document.as_kind("time", "time") == 0.02
    assert document.section("table").as_kind("key", "number") == -1.5
    assert dict(document.section("absent").data) == {}
    assert [s.path for s in document.sections("list")] == ["list[1]", "list[2]"]


@pytest.mark.parametrize(
    ("read", "message"),
    [
        (lambda d: d.as_kind("number", "text"), "a.toml: number = 3 is not valid; give a string"),
        (lambda d: d.as_kind("blank", "text"), "a.toml: blank = ' ' is not valid; give a string"),
        (lambda d: d.as_kind("flag", "number"), "a.toml: flag = true is not valid; give a number"),
        (lambda d: d.as_kind("huge", "number"), "a.toml: huge = inf is not valid; give a number"),
        (lambda d: d.as_kind("vast", "number"), "a.toml: vast = 1000"),
        (
            lambda d: d.as_kind("large", "integer"),
            "a.toml: large = 9223372036854775808 is not valid; give a",
        ),
        (
            lambda d: d.as_kind("never", "time"),
            "a.toml: never = {value = 1e+308, unit = 'h'} is not",
        ),
        (lambda d: d.section("title"), "a.toml: title = 'A title' is not valid; give a table"),
        (
            lambda d: d.as_kind("mixed", "texts"),
            "a.toml: mixed = ['a', 1] is not valid; give an array of strings",
        ),
        (
            lambda d: list(d.sections("table")),
            "a.toml: table = {key = -1.5} is not valid; give an array of tables, [[table]]",
        ),
        (
            lambda d: d.as_kind("year", "time"),
            "a.toml: year.unit = 'sec' is no time; did you mean 's'?",
        ),
        (lambda d: d.as_kind("half", "time"), "a.toml: half.unit is missing"),
        (
            lambda d: d.section("table").only(["kye", "other"]),
            "a.toml: table.key is not known here; did you mean 'kye'?",
        ),
        (
            lambda d: [s.only(["name"]) for s in d.sections("list")],
            "a.toml: list[2].nmae is not known here; did you mean 'name'?",
        ),
        (lambda d: d.section("table").require("key", "lock"), "a.toml: table.lock is missing"),
        (lambda d: d.attempt("number", lambda: int("x")), "a.toml: number: invalid literal"),
    ],
)
def test_mistakes_are_told_with_their_place(
    document: Section, read: Callable[[Section], object], message: str
) -> None:
    with pytest.raises(InvalidInput) as refused:
        read(document)
    assert str(refused.value).startswith(message)
    assert "\n" not in str(refused.value)


def test_a_key_set_elsewhere_is_told_with_that_place() -> None:
    section = Section("a.toml", "experiment", {"step": "x"}, {"step": "variants[1].set.step"})
    with pytest.raises(InvalidInput, match=r"^a\.toml: variants\[1\]\.set\.step = 'x' is not"):
        section.as_kind("step", "number")


def test_long_values_are_cut_in_messages() -> None:
    with pytest.raises(InvalidInput) as refused:
        Section("a.toml", "", {"key": "x" * 500}).as_kind("key", "number")
    assert len(str(refused.value)) < 120


def test_unreadable_files(tmp_path: Path) -> None:
    (tmp_path / "fig2.toml").write_text("title = x")
    (tmp_path / "latin.toml").write_bytes(b'title = "\xe9"')
    with pytest.raises(InvalidInput, match=r"fig22\.toml: no such file; did you mean 'fig2\.toml'"):
        read_document(tmp_path / "fig22.toml")
    with pytest.raises(InvalidInput, match=r"fig2\.toml: not valid TOML: .* line 1"):
        read_document(tmp_path / "fig2.toml")
    (tmp_path / "digits.toml").write_text(f"number = 1{'0' * 5000}")
    (tmp_path / "deep.toml").write_text(f"list = {'[' * 5000}")
    with pytest.raises(InvalidInput, match=r"digits\.toml: not valid TOML: .* digits"):
        read_document(tmp_path / "digits.toml")
    with pytest.raises(InvalidInput, match=r"deep\.toml: not valid TOML: "):
        read_document(tmp_path / "deep.toml")
    with pytest.raises(InvalidInput, match=r"latin\.toml: line \d+ is no UTF-8 text"):
        read_document(tmp_path / "latin.toml")
    with pytest.raises(InvalidInput, match="this is a folder; give a file"):
        read_document(tmp_path)
    with pytest.raises(InvalidInput, match=r"give the path of a scenario \(\.toml\)"):
        read_document(tmp_path / "absent" / "fig2.toml")
