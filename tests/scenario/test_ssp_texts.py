"""What export-ssp writes of texts: what they are, and no file that they happen to name."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from congelation.errors import InvalidInput
from congelation.scenario.load import load_scenario
from congelation.scenario.ssp import read_ssp, write_ssp

XML = (
    '<fmiModelDescription fmiVersion="2.0" modelName="m" guid="{1}">'
    '<CoSimulation modelIdentifier="m"/><ModelVariables>'
    '<ScalarVariable name="s" valueReference="0" causality="parameter" variability="fixed">'
    '<String start="dflt"/></ScalarVariable>'
    "</ModelVariables><ModelStructure/></fmiModelDescription>"
)


def exported(folder: Path, text: str, title: str = "t", name: str = "m") -> Path:
    """The archive of a scenario whose one component has the text as a start value."""
    with zipfile.ZipFile(folder / "m.fmu", "w") as fmu:
        fmu.writestr("modelDescription.xml", XML)
    file = folder / "s.toml"
    file.write_text(
        f'title = "{title}"\n[components."{name}"]\nfmu = "m.fmu"\nstart = {{s = "{text}"}}\n'
        "[experiment]\nstop_time = 1\nstep = 0.1\n",
        encoding="utf-8",
    )
    archive = folder / "s.ssp"
    write_ssp(load_scenario(file), archive)
    return archive


@pytest.mark.parametrize("text", ["abc", "", "x" * 600, "a\\tb"])
def test_a_text_is_written_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    """Also where a file of the current folder has that name, or the FMU has another default."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "abc").write_text("private")
    archive = exported(tmp_path, text)
    (component,) = read_ssp(archive).system.components
    assert component.start == {"s": text.replace("\\t", "\t")}
    with zipfile.ZipFile(archive) as packed:
        assert not any(name.endswith("abc") for name in packed.namelist())


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"text": "a\\u0001b"}, r"start value 's' = 'a\\x01b' has characters that XML"),
        ({"text": "", "title": "a\\u0001b"}, r"title = .* give characters that can be shown"),
        ({"text": "", "name": "a\\u0007"}, r"component 'a\\x07': a name without"),
    ],
)
def test_characters_that_xml_cannot_hold_are_named(
    tmp_path: Path, change: dict[str, str], place: str
) -> None:
    with pytest.raises(InvalidInput, match=place):
        exported(tmp_path, **change)
    assert not (tmp_path / "s.ssp").exists()


@pytest.mark.parametrize("name", ["a:b", "a\\\\b", "a?b"])
def test_a_name_that_is_none_of_a_file_is_read_back(tmp_path: Path, name: str) -> None:
    (component,) = read_ssp(exported(tmp_path, "x", name=name)).system.components
    assert component.name == name.replace("\\\\", "\\")
    assert component.start == {"s": "x"}
