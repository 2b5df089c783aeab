"""The native twin of an FMU: the same variables and equations as C, compiled, without Python.

The tables and equations of a model (`native_source`) are compiled with the C layer in
fmu_src/native; modelDescription.xml and the documentation are those of the Python FMU, so that
names, value references, defaults and dependencies are the same. Nothing of the Python FMU is packed
for that.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import fmpy

from congelation.export.interface import Interface, StateVariable, state_variables
from congelation.export.model_description import add_model_exchange
from congelation.export.native_source import model_source
from congelation.export.pack import write_archive
from congelation.export.platforms import Platform, library
from congelation.export.spec import FmuSpec
from congelation.export.stage import Staged
from congelation.theory.model import Model

__all__ = ["native_fmu"]

# The start of all GUIDs of native FMUs; it only has to stay the same, and to be another than that
# of the Python FMUs.
_NAMESPACE = uuid.UUID("6f0f1b3e-9f0e-5a52-8f6c-7d2d1c1f7a11")
_MODEL = "model.c"


def native_fmu(
    target: Path,
    fmu: FmuSpec,
    staged: Staged,
    description: bytes,
    sources: Path,
    platforms: Sequence[Platform],
) -> None:
    """Write the native twin of a Python FMU.

    Parameters
    ----------
    target : Path
        The file to write.
    fmu : FmuSpec
        What to build.
    staged : Staged
        The Python FMU's sources, from which documentation and icon are taken.
    description : bytes
        The Python FMU's modelDescription.xml.
    sources : Path
        The folder fmu_src.
    platforms : sequence of Platform
        What it is to run on.

    Raises
    ------
    CongelationError
        The compiler that is needed is not here, or it failed.
    """
    about = staged.about.read_bytes()
    headers = Path(fmpy.__file__).parent / "c-code"
    layer = {
        file.name: file.read_bytes()
        for folder, pattern in ((headers, "fmi2*.h"), (sources / "native", "*.[ch]"))
        for file in sorted(folder.glob(pattern))
    }
    states = state_variables(fmu.model, fmu.profiles, staged.interface)
    body = model_source(fmu.model, fmu.special, staged.interface, states)
    key = hashlib.sha256(body.encode("utf-8"))
    for name, data in (*layer.items(), ("spec.json", about)):
        key.update(name.encode("utf-8") + len(data).to_bytes(8, "big") + data)
    guid = f"{{{uuid.uuid5(_NAMESPACE, fmu.name + key.hexdigest())}}}"
    identity = [
        f'const char MODEL_GUID[] = "{guid}";',
        f"const unsigned char MODEL_KEY[32] = {{{', '.join(map(str, key.digest()))}}};",
    ]
    model = (body + "\n".join(identity) + "\n").encode("utf-8")
    code = {**layer, _MODEL: model}
    files = [name for name in sorted(code) if name.endswith(".c")]
    xml, identifier = _description(description, guid, files, fmu.model, staged.interface, states)
    entries = {
        "documentation/index.html": (staged.documentation / "index.html").read_bytes(),
        "documentation/licenses/license.txt": (sources / "native" / "licenses.txt").read_bytes(),
        "model.png": staged.icon,
        "resources/spec.json": about,
        **{
            f"binaries/{p.folder}/{identifier}{p.extension}": library(fmu.name, layer, model, p)
            for p in platforms
        },
        **{f"sources/{name}": data for name, data in code.items()},
    }
    write_archive(target, [("modelDescription.xml", xml), *sorted(entries.items())])


def _description(
    xml: bytes,
    guid: str,
    files: Sequence[str],
    model: Model,
    interface: Interface,
    states: tuple[StateVariable, ...],
) -> tuple[bytes, str]:
    """modelDescription.xml of the native FMU, and its modelIdentifier, after which the library is
    named: the twin's with another GUID, source files and model exchange."""
    root = ElementTree.fromstring(xml)
    root.set("guid", guid)
    root.set("generationTool", str(root.get("generationTool")).split(" with ")[0] + " (native)")
    add_model_exchange(root, model, interface, states)
    identifier = ""
    for kind in (*root.iterfind("ModelExchange"), *root.iterfind("CoSimulation")):
        identifier = str(kind.get("modelIdentifier"))
        source_files = ElementTree.SubElement(kind, "SourceFiles")
        for file in files:
            ElementTree.SubElement(source_files, "File", {"name": file})
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text + b"\n", identifier
