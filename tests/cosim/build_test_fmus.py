"""Build the FMUs of tests/cosim/fmus into a folder: python build_test_fmus.py FOLDER.

Run in a process of its own, so that nothing of the sources stays in the tests' sys.modules.
pythonfmu writes no dependencies; those that a slave declares are added here.
"""

import importlib
import sys
import zipfile
from pathlib import Path

from lxml import etree
from pythonfmu.builder import FmuBuilder

SOURCES = Path(__file__).parent / "fmus"
BASE = SOURCES / "cosim_test_base.py"


def main(folder: Path) -> None:
    sys.path.insert(0, str(SOURCES))
    for source in sorted(SOURCES.glob("cosim_test_*.py")):
        if source != BASE:
            module = importlib.import_module(source.stem)
            slave = next(c for name, c in vars(module).items() if name.startswith("Test"))
            able = str(getattr(slave, "complete_state", False)).lower()
            fmu = FmuBuilder.build_FMU(
                source,
                dest=folder,
                project_files=[BASE],
                canGetAndSetFMUstate=able,
                needsExecutionTool="false",
            )
            declare(Path(fmu), getattr(slave, "dependencies", None))


def declare(fmu: Path, dependencies: dict[str, list[str]] | None) -> None:
    """Write the dependencies of the outputs into the model description."""
    if dependencies is None:
        return
    with zipfile.ZipFile(fmu) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    root = etree.fromstring(files["modelDescription.xml"])
    names = [variable.get("name") for variable in root.find("ModelVariables")]
    for unknown in root.find("ModelStructure/Outputs"):
        known = dependencies[names[int(unknown.get("index")) - 1]]
        unknown.set("dependencies", " ".join(str(names.index(name) + 1) for name in known))
    files["modelDescription.xml"] = etree.tostring(root, xml_declaration=True, encoding="UTF-8")
    with zipfile.ZipFile(fmu, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
