"""Native FMUs for other systems, built by ziglang, and run where an emulator is here.

`make test-platforms` installs what these tests need; without it they are skipped, and say so.
"""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import fmpy
import pytest

from congelation.errors import CongelationError, InvalidInput
from congelation.export.build import build
from congelation.export.platforms import PLATFORMS
from tests.native.test_twins import NATIVE
from tests.scenarios import ROOT

SPEC = ROOT / "specs" / "output_feedback.toml"
NAMES = ("ObserverFormPlant", "OutputFeedbackController")
STEPS = 200
REMEDY = "make test-platforms installs it"

needs_zig = pytest.mark.skipif(
    find_spec("ziglang") is None, reason=f"there is no ziglang; {REMEDY}"
)
WINE = shutil.which("wine64") or shutil.which("wine64", path="/usr/lib/wine")
QEMU, ARM = shutil.which("qemu-aarch64"), Path("/usr/aarch64-linux-gnu")


def test_an_unknown_platform_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="--platform 'win32' is not known; valid: 'linux64', "):
        build(SPEC, out=tmp_path, native=True, platforms=["linux64", "win32"])
    with pytest.raises(InvalidInput, match="--platform is about native FMUs; give --native, too"):
        build(SPEC, out=tmp_path, platforms=["win64"])
    assert list(tmp_path.iterdir()) == []


def test_without_ziglang_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("congelation.export.platforms.find_spec", lambda name: None)
    with pytest.raises(CongelationError) as error:
        build(ROOT / "specs" / "scalar.toml", out=tmp_path, native=True, platforms=["win64"])
    assert str(error.value) == (
        "ScalarPlant: for win64 it is compiled by ziglang, which is not installed; "
        "pip install 'congelation[native-platforms]'"
    )


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the FMUs for all platforms."""
    folder = tmp_path_factory.mktemp("platforms")
    paths = build(SPEC, out=folder, native=True, platforms=list(PLATFORMS))
    found = sorted(path.relative_to(folder / "native").as_posix() for path in paths)
    assert found == sorted(
        f"{place}{name}.fmu" for name in NAMES for place in ("", "aarch64-linux/", "darwin64/")
    )
    return folder / "native"


def unpacked(path: Path, folder: Path) -> tuple[Path, str]:
    """The binaries of an FMU, and its GUID."""
    guid: str = fmpy.read_model_description(str(path)).guid
    return Path(fmpy.extract(str(path), str(folder))) / "binaries", guid


def driven(command: list[str], library: str, guid: str, **environment: str) -> list[float]:
    """The outputs of a run in the driver."""
    description = fmpy.read_model_description(str(NATIVE / f"{Path(library).stem}.fmu"))
    variables = description.modelVariables
    inputs, outputs = (
        [v.valueReference for v in variables if v.causality == causality]
        for causality in ("input", "output")
    )
    lists = [len(inputs), *inputs, len(outputs), *outputs]
    done = subprocess.run(
        [*command, library, guid, str(STEPS), "0.01", *map(str, lists)],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    numbers = [struct.unpack(">d", bytes.fromhex(line))[0] for line in done.stdout.split()]
    assert len(numbers) == STEPS * len(outputs)
    return numbers


def compiled(folder: Path, *compiler: str) -> str:
    """The driver, made by a compiler."""
    headers = Path(fmpy.__file__).parent / "c-code"
    program = folder / "driver.exe"
    source = Path(__file__).with_name("driver.c")
    flags = ["-O2", "-s", f"-I{headers}"]
    command = [*compiler, *flags, str(source), "-o", str(program)]
    subprocess.run(command, check=True, capture_output=True)
    return str(program)


def zig(target: str) -> tuple[str, ...]:
    return (sys.executable, "-m", "ziglang", "cc", "-target", target)


@pytest.fixture(scope="module")
def linux(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[float]]:
    """The run of each FMU of `make fmus` on this machine."""
    folder = tmp_path_factory.mktemp("linux")
    driver = compiled(folder, "gcc", "-Wall", "-Wextra", "-Werror")
    runs = {}
    for name in NAMES:
        binaries, guid = unpacked(NATIVE / f"{name}.fmu", folder / name)
        runs[name] = driven([driver], str(binaries / "linux64" / f"{name}.so"), guid)
    return runs


@needs_zig
def test_the_library_for_an_old_glibc_gives_equal_bits(
    fmus: Path, linux: dict[str, list[float]], tmp_path: Path
) -> None:
    driver = compiled(tmp_path, "gcc")
    for name in NAMES:
        binaries, guid = unpacked(fmus / f"{name}.fmu", tmp_path / name)
        library = binaries / "linux64" / f"{name}.so"
        symbols = subprocess.run(
            ["readelf", "--dyn-syms", "--wide", library], check=True, capture_output=True, text=True
        ).stdout
        versions = {
            tuple(map(int, word.partition("@GLIBC_")[2].split(".")))
            for word in symbols.split()
            if "@GLIBC_" in word
        }
        assert versions
        assert max(versions) <= (2, 17)
        assert driven([driver], str(library), guid) == linux[name]


@needs_zig
@pytest.mark.skipif(WINE is None, reason=f"there is no wine64; {REMEDY}")
def test_windows_libraries_run_under_wine(
    fmus: Path, linux: dict[str, list[float]], tmp_path: Path
) -> None:
    """Not equal to the last bit: the sines and powers of Windows' C library are other ones."""
    driver = compiled(tmp_path, *zig("x86_64-windows-gnu"))
    home = {"WINEPREFIX": str(tmp_path / "prefix"), "WINEDEBUG": "-all"}
    assert WINE is not None
    for name in NAMES:
        binaries, guid = unpacked(fmus / f"{name}.fmu", tmp_path / name)
        library = f"Z:{binaries / 'win64' / name}.dll"
        found = driven([WINE, driver], library, guid, **home)
        for value, expected in zip(found, linux[name], strict=True):
            assert value == pytest.approx(expected, rel=1e-13, abs=1e-13)


@needs_zig
@pytest.mark.skipif(
    QEMU is None or not ARM.is_dir(),
    reason=f"there is no qemu-aarch64, or no C library for it in {ARM}; {REMEDY}",
)
def test_arm_libraries_run_under_qemu(
    fmus: Path, linux: dict[str, list[float]], tmp_path: Path
) -> None:
    driver = compiled(tmp_path, *zig("aarch64-linux-gnu.2.17"))
    for name in NAMES:
        binaries, guid = unpacked(fmus / "aarch64-linux" / f"{name}.fmu", tmp_path / name)
        library = binaries / "linux64" / f"{name}.so"
        found = driven([str(QEMU), "-L", str(ARM), driver], str(library), guid)
        assert found == linux[name]


MACH_O, FAT, DYNAMIC_LIBRARY, SYMBOL_TABLE = 0xFEEDFACF, 0xCAFEBABE, 6, 2
X86_64, ARM64 = 0x01000007, 0x0100000C


def exported(slice_: bytes) -> tuple[int, set[str]]:
    """Processor and exported names of a Mach-O library (mach-o/loader.h, mach-o/nlist.h)."""
    magic, processor, _, kind, commands = struct.unpack_from("<5I", slice_)
    assert (magic, kind) == (MACH_O, DYNAMIC_LIBRARY)
    names, place = set(), 32
    for _ in range(commands):
        command, size = struct.unpack_from("<2I", slice_, place)
        if command == SYMBOL_TABLE:
            symbols, count, strings = struct.unpack_from("<3I", slice_, place + 8)
            for k in range(count):
                text, type_ = struct.unpack_from("<IB", slice_, symbols + 16 * k)
                # External, and defined here (N_EXT, N_SECT), not private to the library (N_PEXT).
                if type_ & 0x1F == 0x0F:
                    end = slice_.index(b"\0", strings + text)
                    names.add(slice_[strings + text : end].decode())
        place += size
    return processor, names


@needs_zig
def test_mac_libraries_have_the_format_and_the_functions(fmus: Path, tmp_path: Path) -> None:
    """They cannot be run here."""
    for name in NAMES:
        binaries, _ = unpacked(fmus / "darwin64" / f"{name}.fmu", tmp_path / name)
        data = (binaries / "darwin64" / f"{name}.dylib").read_bytes()
        magic, count = struct.unpack_from(">2I", data)
        assert (magic, count) == (FAT, 2)
        processors = []
        for k in range(count):
            own, _, start, size, align = struct.unpack_from(">5I", data, 8 + 20 * k)
            assert start % (1 << align) == 0
            processor, names = exported(data[start : start + size])
            assert processor == own
            processors.append(processor)
            assert {"_fmi2DoStep", "_fmi2GetDerivatives"} <= names
            # __mh_dylib_header and ___dso_handle are the linker's.
            own_names = {symbol for symbol in names if not symbol.startswith("__")}
            assert all(symbol.startswith("_fmi2") for symbol in own_names), own_names
        assert processors == [X86_64, ARM64]


@needs_zig
@pytest.mark.parametrize("platform", ["linux64", "aarch64-linux"])
def test_linux_libraries_have_the_format_and_the_functions(
    fmus: Path, tmp_path: Path, platform: str
) -> None:
    machine = {"linux64": "Advanced Micro Devices X86-64", "aarch64-linux": "AArch64"}[platform]
    folder = fmus / platform if PLATFORMS[platform].apart else fmus
    for name in NAMES:
        binaries, _ = unpacked(folder / f"{name}.fmu", tmp_path / name)
        shown = subprocess.run(
            ["readelf", "--file-header", "--dyn-syms", "--wide", binaries / f"linux64/{name}.so"],
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        assert machine in shown
        rows = [line.split() for line in shown.splitlines() if " FUNC " in line]
        defined = {row[7] for row in rows if row[6] != "UND" and row[4] == "GLOBAL"}
        assert "fmi2DoStep" in defined
        assert all(symbol.startswith("fmi2") for symbol in defined), defined
