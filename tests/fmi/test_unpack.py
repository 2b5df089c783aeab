"""Archives are hostile: nothing is written outside a folder, and no disk is filled."""

from __future__ import annotations

import stat
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from congelation.errors import InvalidInput
from congelation.export.spec import read_spec
from congelation.fmi import unpack
from congelation.fmi.description import describe
from congelation.fmi.unpack import check_archive, unpack_archive
from congelation.scenario.load import load_scenario
from tests.scenarios import FMUS, ROOT, write
from tests.studies import command as congelation
from tests.studies import last_line


def pack(file: Path, *names: str, content: bytes = b"") -> Path:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as target:
        for name in names:
            target.writestr(name, content)
    return file


@pytest.mark.parametrize(
    "name",
    ["../evil", "a/../../evil", "/evil", "..\\evil", "a\\b", "C:/evil", "resources/..", "a\0b"],
)
@pytest.mark.parametrize("suffix", ["fmu", "ssp"])
def test_nothing_is_written_outside(tmp_path: Path, name: str, suffix: str) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    # ZipInfo repairs some of these names, so another of the length is put in and replaced.
    stand_in = "x" * len(name)
    file = pack(inner / f"a.{suffix}", "modelDescription.xml", "SystemStructure.ssd", stand_in)
    file.write_bytes(file.read_bytes().replace(stand_in.encode(), name.encode()))
    before = sorted(tmp_path.rglob("*"))
    read: Callable[[Path], object] = load_scenario if suffix == "ssp" else describe
    with pytest.raises(InvalidInput, match="does not lie inside the archive's folder"):
        read(file)
    with pytest.raises(InvalidInput, match="does not lie inside the archive's folder"):
        unpack_archive(file, inner / "out", "an FMU")
    assert sorted(tmp_path.rglob("*")) == before


def test_a_symbolic_link_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "a.fmu"
    with zipfile.ZipFile(file, "w") as target:
        link = zipfile.ZipInfo("resources/link")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        target.writestr(link, "/etc")
    with pytest.raises(InvalidInput, match="'resources/link' is a symbolic link"):
        check_archive(file, "an FMU")


def test_a_bomb_is_refused(tmp_path: Path) -> None:
    bomb = pack(tmp_path / "a.fmu", "modelDescription.xml", content=bytes(100 * 2**20))
    assert bomb.stat().st_size < 200_000
    with pytest.raises(InvalidInput, match=r"grows to \d+ times its size; at most 100 times is"):
        describe(bomb)


def test_sizes_and_numbers_have_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = pack(tmp_path / "a.fmu", "a", "b", "c", content=bytes(range(256)) * 4)
    check_archive(file, "an FMU")
    monkeypatch.setattr(unpack, "MOST_BYTES", 3071)
    with pytest.raises(InvalidInput, match="GiB unpacked; at most"):
        check_archive(file, "an FMU")
    monkeypatch.setattr(unpack, "MOST_FILES", 2)
    with pytest.raises(InvalidInput, match="3 files; at most 2 are unpacked"):
        check_archive(file, "an FMU")


def test_a_size_that_lies_fills_nothing(tmp_path: Path) -> None:
    """The directory says 10 bytes where there are a million: no more than 10 are written."""
    file = pack(tmp_path / "a.fmu", "a", content=bytes(10**6))
    data = file.read_bytes().replace(struct.pack("<I", 10**6), struct.pack("<I", 10))
    file.write_bytes(data)
    with pytest.raises(InvalidInput, match="is not an FMU: "):
        unpack_archive(file, tmp_path / "out", "an FMU")
    assert sum(f.stat().st_size for f in (tmp_path / "out").rglob("*")) <= 10


def test_one_name_twice_is_refused(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="Duplicate name"):
        file = pack(tmp_path / "a.fmu", "a", "a")
    with pytest.raises(InvalidInput, match="'a' is in the archive twice"):
        check_archive(file, "an FMU")


def test_damaged_archives_are_named(tmp_path: Path) -> None:
    whole = (FMUS / "ScalarPlant.fmu").read_bytes()
    for size in (0, 10, len(whole) // 2, len(whole) - 5):
        file = tmp_path / f"{size}.fmu"
        file.write_bytes(whole[:size])
        with pytest.raises(InvalidInput, match="is not an FMU: "):
            describe(file)
    flipped = bytearray(whole)
    middle = len(whole) // 3
    flipped[middle : middle + 64] = bytes(64)
    file = tmp_path / "flipped.fmu"
    file.write_bytes(flipped)
    with pytest.raises(InvalidInput):
        unpack_archive(file, tmp_path / "out", "an FMU")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('fmiVersion="2.0"', 'fmiVersion="3.0"', "FMI 3.0"),
        ('fmiVersion="2.0"', 'fmiVersion="1.0"', "FMI 1.0"),
        ("CoSimulation ", "ModelExchange ", "model exchange alone; co-simulation is needed"),
        (
            'modelIdentifier="ScalarPlant"',
            'modelIdentifier="../../ScalarPlant"',
            "modelIdentifier '../../ScalarPlant' is not valid",
        ),
    ],
)
def test_other_fmus_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    with zipfile.ZipFile(FMUS / "ScalarPlant.fmu") as source:
        text = source.read("modelDescription.xml").decode()
    assert old in text
    file = pack(tmp_path / "a.fmu", "modelDescription.xml", content=text.replace(old, new).encode())
    with pytest.raises(InvalidInput) as told:
        describe(file)
    assert str(told.value).startswith(str(file))
    assert message in str(told.value)


@pytest.mark.parametrize(
    ("file", "message"),
    [
        (FMUS / "ScalarPlant.fmu", "this is an FMU; check it with: congelation check "),
        (ROOT / "specs" / "scalar.toml", "this is a spec, from which FMUs are built"),
        (ROOT / "specs", "this is a folder; give a file (.toml)"),
    ],
)
def test_another_kind_of_file_for_a_scenario_is_named(file: Path, message: str) -> None:
    with pytest.raises(InvalidInput) as told:
        load_scenario(file)
    assert str(told.value).startswith(f"{file}: {message}")


@pytest.mark.parametrize("command", ["info", "check"])
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a.toml", "this is a TOML file, not an FMU; a scenario is run (congelation run "),
        ("a.ssp", "this is an SSP archive, not an FMU; run it with: congelation run "),
        ("a.fmu", "this is an SSP archive, not an FMU; run it with: congelation run "),
    ],
)
def test_another_kind_of_file_for_an_fmu_is_named(
    tmp_path: Path, command: str, name: str, message: str
) -> None:
    file = tmp_path / name
    if file.suffix == ".toml":
        file.write_text('title = "a"\n')
    else:
        pack(file, "SystemStructure.ssd")
    done = congelation(command, file)
    assert (done.returncode, done.stdout) == (2, "")
    assert last_line(done, 2).startswith(f"congelation: {file}: {message}")


@pytest.mark.parametrize("command", ["attack", "tune"])
def test_what_is_no_scenario_or_spec_is_refused_without_a_bar(tmp_path: Path, command: str) -> None:
    file = pack(tmp_path / "a.toml", "modelDescription.xml")
    done = congelation(command, file, "--out", tmp_path / "out")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.startswith(f"congelation: {file}: this is an FMU; check it with")


def test_another_kind_of_file_for_a_spec_is_named(tmp_path: Path) -> None:
    for file, message in (
        (FMUS / "ScalarPlant.fmu", "this is an FMU"),
        (write(tmp_path), "this is a scenario (congelation run "),
        (tmp_path, "this is a folder"),
        (pack(tmp_path / "a.zip", "a"), "this is a ZIP archive; give a TOML file"),
        (pack(tmp_path / "a.toml", "SystemStructure.ssd"), "this is an SSP archive; it can be run"),
    ):
        with pytest.raises(InvalidInput) as told:
            read_spec(file)
        assert str(told.value).startswith(f"{file}: {message}")
    with pytest.raises(InvalidInput, match=r"this is a folder; give an FMU \(\.fmu\)"):
        describe(tmp_path)


def test_variables_of_one_name_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "a.fmu"
    with zipfile.ZipFile(FMUS / "ScalarPlant.fmu") as source, zipfile.ZipFile(file, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == "modelDescription.xml":
                content = content.replace(b'name="u"', b'name="x"')
            target.writestr(name, content)
    with pytest.raises(InvalidInput, match="has 2 variables named 'x'; names must be unique"):
        describe(file)
