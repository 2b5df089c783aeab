"""From staged sources to an .fmu file: pythonfmu's builder, then what it leaves undone."""

from __future__ import annotations

import importlib.metadata
import re
import sys
import tempfile
import zipfile
from pathlib import Path
from types import ModuleType

from pythonfmu.builder import FmuBuilder

from congelation.errors import InvalidInput
from congelation.export.model_description import complete
from congelation.export.spec import FmuSpec, Spec
from congelation.export.stage import Staged, stage

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
# Zip's epoch: equal sources must give equal bytes.
_DATE = (1980, 1, 1, 0, 0, 0)
_MODE = 0o644 << 16


def build(fmu: FmuSpec, spec: Spec, sources: Path, out: Path) -> Path:
    """Build one FMU of a spec.

    Parameters
    ----------
    fmu : FmuSpec
        The plant or the controller of `spec`.
    sources : Path
        The folder fmu_src.
    out : Path
        Folder for the .fmu file, which is named after the FMU.

    Returns
    -------
    Path
        The .fmu file.
    """
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="congelation_build_") as temporary:
        folder = Path(temporary)
        staged = stage(fmu, spec, sources, folder / "staged")
        raw = _pythonfmu(staged, folder / "raw")
        target = out / f"{fmu.name}.fmu"
        finished = folder / target.name
        _finish(raw, finished, staged)
        target.write_bytes(finished.read_bytes())
    return target


def _pythonfmu(staged: Staged, out: Path) -> Path:
    """Run pythonfmu's builder, which imports the slave, and leave the interpreter as it was."""
    path = list(sys.path)
    # An FMU of the same sources may be loaded in this process, with its own copy of pythonfmu.
    loaded = _taken_out(staged.package)
    try:
        return Path(
            FmuBuilder.build_FMU(
                staged.slave,
                dest=out,
                project_files=set(staged.resources),
                documentation_folder=staged.documentation,
                **_OPTIONS,
            )
        )
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


def _finish(raw: Path, target: Path, staged: Staged) -> None:
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
    tool = "congelation {} with PythonFMU {}".format(
        importlib.metadata.version("congelation"), importlib.metadata.version("pythonfmu")
    )
    description = finished.pop("modelDescription.xml")
    finished[f"resources/{staged.package}/pythonfmu/__init__.py"] = b""
    finished["documentation/licenses/license.txt"] = _LICENSES.encode("ascii")
    finished["documentation/externalDependencies.txt"] = _DEPENDENCIES.encode("ascii")
    finished["model.png"] = staged.icon
    # modelDescription.xml comes first: hosts that stream the archive find it at once.
    ordered = [
        ("modelDescription.xml", complete(description, staged.interface, staged.digest, tool)),
        *sorted(finished.items()),
    ]
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, data in ordered:
            info = zipfile.ZipInfo(name, _DATE)
            info.external_attr = _MODE
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, data)


_LICENSES = """\
This FMU was built by congelation (MIT licence) and contains parts of PythonFMU (MIT licence,
Copyright (c) 2019 Norwegian University of Science and Technology and others): the library under
binaries and the Python package under resources that carries its name.
"""
_DEPENDENCIES = """\
This FMU runs on the Python of its host: Python 3.9 or newer, 64 bit, the standard library alone.

The library under binaries uses the functions of libpython without naming a version of it. In a host
that is a Python process they are there. Any other host on Linux has to be started with them:

    LD_PRELOAD=/path/to/libpython3.11.so host

On Windows python3.dll must be found on the PATH.
"""
