"""From specs to .fmu files: derive, stage, package with PythonFMU, complete, validate, list."""

from __future__ import annotations

import importlib.metadata
import re
import sys
import tempfile
import warnings
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

from pythonfmu.builder import FmuBuilder, get_model_description

from congelation.arguments import checked
from congelation.errors import CongelationError, DesignWarning, InvalidInput
from congelation.export import manifest
from congelation.export.embedded_c import controller_code
from congelation.export.model_description import complete
from congelation.export.native_fmu import native_fmu
from congelation.export.pack import write_archive
from congelation.export.platforms import Platform, chosen_platforms
from congelation.export.spec import BlockSpec, FmuSpec, Spec, read_buildable
from congelation.export.spec_assumptions import spec_warnings
from congelation.export.stage import Staged, stage
from congelation.fmi.validation import validate
from congelation.places import check_folder, shipped, write_whole

__all__ = ["build"]

_OPTIONS = {
    # The interpreter runs in the host's process; no tool is started.
    "needsExecutionTool": False,
    "canHandleVariableCommunicationStepSize": True,
    "canGetAndSetFMUstate": True,
    "canSerializeFMUstate": True,
}
# What a slave needs of pythonfmu at run time; its builder stays out.
_RUN_TIME = ("_version", "default_experiment", "enums", "fmi2slave", "logmsg", "variables")
_IMPORT = re.compile(r"^from pythonfmu\.", re.MULTILINE)
# What the content of an FMU follows from, besides its spec.
_TOOLS = ("congelation", "casadi", "pythonfmu", "fmpy")


@checked
def build(
    *specs: Spec | BlockSpec | Path | str,
    out: Path | str = "fmus",
    native: bool = False,
    platforms: Sequence[str] = (),
    c_code: bool = False,
) -> list[Path]:
    """Build the FMUs of specs: a plant and a controller each, or a block.

    Equal specs, built by equal versions, give byte-identical files. Beside the FMUs there is
    ``manifest.json``, with what each was built of.

    Parameters
    ----------
    *specs : Spec, BlockSpec, Path or str
        What to build: a TOML file, or what `Spec.read` made of one.
    out : Path or str
        Folder for the FMUs, which replace others of the same names.
    native : bool
        Build their native twins instead, which need no Python where they run, into the folder
        ``native`` of `out`.
    platforms : sequence of str
        What native FMUs are to run on: "linux64" (which is also meant by none), "win64",
        "aarch64-linux", "darwin64". The first two go into one file, each other into a file of its
        own in a folder of its name.
    c_code : bool
        Write the bare controllers as C for sampled control instead, each into a folder of its name
        in the folder ``c`` of `out`: controller.h, controller.c and an example main.c.

    Returns
    -------
    list of Path
        The .fmu files, or the C files: the plant and the controller (or the block) of the first
        spec, of the second, and so on.

    Raises
    ------
    InvalidInput
        A spec is wrong, two FMUs have one name, nothing can be written to `out`, a native FMU or C
        code is asked for of what has none, or both at once.
    CongelationError
        A native FMU cannot be compiled.

    Warns
    -----
    DesignWarning
        A spec breaks an assumption of its design's theorem, or whether it does cannot be known.

    Examples
    --------
    >>> paths = cg.build("specs/scalar.toml", out=folder)
    >>> [path.name for path in paths]
    ['ScalarPlant.fmu', 'ScalarController.fmu']
    """
    if native and c_code:
        raise InvalidInput("--native and --c-code: give one of the two; they are different builds")
    if platforms and not native:
        raise InvalidInput("--platform is about native FMUs; give --native, too")
    chosen = chosen_platforms(platforms)
    folder = Path(out) / ("native" if native else "c" if c_code else "")
    if not specs:
        raise InvalidInput("no spec is given; name one or more, such as specs/f16_pitch.toml")
    check_folder("--out", folder)
    groups = _groups(chosen, folder) if native else {folder: ()}
    read = _read(specs, c_code=c_code)
    for spec in read:
        for line in spec_warnings(spec) if isinstance(spec, Spec) else ():
            warnings.warn(f"spec '{spec.name}': {line}", DesignWarning, stacklevel=2)
    paths: list[Path] = []
    try:
        for given, spec in zip(specs, read, strict=True):
            source = None if isinstance(given, Spec | BlockSpec) else Path(given)
            for fmu in spec.fmus:
                if c_code:
                    if fmu.role == "controller":
                        paths += controller_code(fmu, folder / fmu.name)
                    continue
                for path in _build_fmu(fmu, spec, groups):
                    paths.append(path)
                    manifest.enter(path, _entry(path, fmu, spec), source)
    except OSError as error:
        raise CongelationError(f"{folder}: an FMU cannot be written: {error}") from error
    return paths


def _read(
    specs: Sequence[Spec | BlockSpec | Path | str], *, c_code: bool
) -> list[Spec | BlockSpec]:
    """The specs, read; refuses what would overwrite another, and C code of a block."""
    read = [
        spec if isinstance(spec, Spec | BlockSpec) else read_buildable(Path(spec)) for spec in specs
    ]
    # No FMU may overwrite another, also where file names do not tell case apart.
    owner: dict[str, Spec | BlockSpec] = {}
    for spec in read:
        for fmu in spec.fmus:
            other = owner.setdefault(fmu.name.lower(), spec)
            if other is not spec:
                raise InvalidInput(
                    f"spec '{spec.name}': '{fmu.name}' is an FMU of spec '{other.name}' too; give "
                    "it another name, or build into another folder"
                )
        if c_code and isinstance(spec, BlockSpec):
            raise InvalidInput(
                f"spec '{spec.name}': a block has no controller to write as C; build it without "
                "--c-code"
            )
    return read


def _groups(platforms: Sequence[Platform], folder: Path) -> dict[Path, tuple[Platform, ...]]:
    """The platforms of each file of a native FMU, by the folder that it goes into."""
    together = tuple(p for p in platforms if not p.apart)
    apart = {folder / p.name: (p,) for p in platforms if p.apart}
    for own in apart:
        check_folder("--out", own)
    return {**({folder: together} if together else {}), **apart}


def _build_fmu(
    fmu: FmuSpec, spec: Spec | BlockSpec, groups: Mapping[Path, Sequence[Platform]]
) -> list[Path]:
    """Build one FMU of `spec` into each of the folders, natively where platforms are given."""
    sources = shipped("fmu_src")
    built = []
    with tempfile.TemporaryDirectory(prefix="congelation_build_") as temporary:
        folder = Path(temporary)
        staged = stage(fmu, spec, sources, folder / "staged")
        for out, platforms in groups.items():
            target = out / f"{fmu.name}.fmu"
            finished = folder / target.name
            if platforms:
                described = _described(fmu, staged)
                native_fmu(finished, fmu, staged, described, sources, platforms)
            else:
                _finish(_pythonfmu(staged, folder / "raw"), finished, staged, sources)
            validate(finished)
            write_whole(target, finished.read_bytes())
            built.append(target)
    return built


def _pythonfmu(staged: Staged, out: Path) -> Path:
    """Run pythonfmu's builder, which imports the slave."""
    with _imported(staged):
        return Path(
            FmuBuilder.build_FMU(
                staged.slave,
                dest=out,
                project_files=set(staged.resources),
                documentation_folder=staged.documentation,
                **_OPTIONS,
            )
        )


def _described(fmu: FmuSpec, staged: Staged) -> bytes:
    """The modelDescription.xml of a Python FMU that is not packed."""
    with _imported(staged):
        _, root = get_model_description(staged.slave, staged.slave.stem, fmu.model.name)
    kind = root.find("CoSimulation")
    for option, value in _OPTIONS.items():
        kind.set(option, str(value).lower())
    return complete(ElementTree.tostring(root), staged.interface, staged.digest, _tool())


@contextmanager
def _imported(staged: Staged) -> Iterator[None]:
    """A time in which the slave may be imported; then the interpreter is as it was.

    Raises
    ------
    InvalidInput
        For what pythonfmu refuses.
    """
    path = list(sys.path)
    # An FMU of the same sources may be loaded in this process, with its own copy of pythonfmu.
    loaded = _taken_out(staged.package)
    try:
        yield
    except ValueError as error:
        raise InvalidInput(f"{staged.name}: {error}") from error
    finally:
        sys.path[:] = path
        _taken_out(staged.package)
        sys.modules.update(loaded)


def _taken_out(package: str) -> dict[str, ModuleType]:
    """The modules of an FMU's package and its slave, which are no longer in sys.modules."""
    names = [name for name in sys.modules if name.startswith(package)]
    return {name: sys.modules.pop(name) for name in names}


def _finish(raw: Path, target: Path, staged: Staged, sources: Path) -> None:
    """Write the zip anew: bundled pythonfmu renamed, XML completed, order and dates fixed."""
    with zipfile.ZipFile(raw) as source:
        entries = {name: source.read(name) for name in source.namelist() if name[-1] != "/"}
    finished: dict[str, bytes] = {}
    for name, data in entries.items():
        if name.startswith("resources/pythonfmu/"):
            if Path(name).stem in _RUN_TIME:
                finished[name.replace("/pythonfmu/", f"/{staged.package}/pythonfmu/")] = data
        elif name.startswith(f"resources/{staged.package}/"):
            finished[name] = _IMPORT.sub("from .pythonfmu.", data.decode("utf-8")).encode("utf-8")
        else:
            finished[name] = data
    description = finished.pop("modelDescription.xml")
    finished[f"resources/{staged.package}/pythonfmu/__init__.py"] = b""
    # The names and places that FMI 2.0.4, section 2.3, gives these two.
    for name, file in (
        ("licenses/license.txt", "licenses.txt"),
        ("externalDependencies.txt", "external_dependencies.txt"),
    ):
        finished[f"documentation/{name}"] = (sources / file).read_bytes()
    finished["model.png"] = staged.icon
    # modelDescription.xml comes first: hosts that stream the archive find it at once.
    ordered = [
        ("modelDescription.xml", complete(description, staged.interface, staged.digest, _tool())),
        *sorted(finished.items()),
    ]
    write_archive(target, ordered)


def _tool() -> str:
    """The generationTool of modelDescription.xml."""
    own, theirs = (importlib.metadata.version(name) for name in ("congelation", "pythonfmu"))
    return f"congelation {own} with PythonFMU {theirs}"


def _entry(path: Path, fmu: FmuSpec, spec: Spec | BlockSpec) -> dict[str, object]:
    """What the manifest says of a built FMU."""
    with zipfile.ZipFile(path) as archive:
        guid = ElementTree.fromstring(archive.read("modelDescription.xml")).get("guid")
    return {
        "guid": guid,
        "model": fmu.model.name,
        "spec": spec.name,
        "tools": {name: importlib.metadata.version(name) for name in _TOOLS},
    }
