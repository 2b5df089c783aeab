"""Build the FMUs: derive the equations, stage the sources, package, complete, validate, list.

python build_fmu.py                       every spec of specs/ that the paper's figures need
python build_fmu.py --spec FILE.toml      the plant and the controller of one spec
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

try:
    from congelation.errors import CongelationError, InvalidInput
    from congelation.export.manifest import update_manifest
    from congelation.export.package import build
    from congelation.export.spec import Spec, read_spec
    from congelation.fmi.validation import validate
    from congelation.places import check_folder
except ModuleNotFoundError as missing:
    sys.exit(
        f"build_fmu.py: this Python ({sys.executable}) has no module '{missing.name}'; "
        "run `make fmus`, which installs everything into .venv, or `. .venv/bin/activate` first"
    )

ROOT = Path(__file__).resolve().parent
# The FMUs of the contract, one spec for each form.
STANDARD = ("scalar", "matched_pendulum", "state_feedback", "output_feedback")


def main(arguments: list[str] | None = None) -> int:
    """Build, and return the exit code: 0, or 2 for a spec that cannot be built."""
    parser = argparse.ArgumentParser(description="Build FMUs from specs.")
    parser.add_argument("--spec", type=Path, action="append", help="a spec; may be repeated")
    parser.add_argument("--out", type=Path, default=ROOT / "fmus", help="where to write them")
    options = parser.parse_args(arguments)
    files = options.spec or [ROOT / "specs" / f"{name}.toml" for name in STANDARD]
    try:
        check_folder("--out", options.out)
        specs = [read_spec(file) for file in files]
        _check_names(files, specs)
        for file, spec in zip(files, specs, strict=True):
            build_spec(file, spec, options.out)
    except CongelationError as error:
        print(f"build_fmu.py: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"build_fmu.py: a file cannot be written: {error}", file=sys.stderr)
        return 2
    return 0


def _check_names(files: Sequence[Path], specs: Sequence[Spec]) -> None:
    """Refuse specs of which one would overwrite the FMUs of another."""
    owner: dict[str, Path] = {}
    for file, spec in zip(files, specs, strict=True):
        for name in (spec.plant.name, spec.controller.name):
            if name.lower() in owner:
                raise InvalidInput(
                    f"{file}: '{name}' is an FMU of {owner[name.lower()]} too; "
                    "give it another name, or build into another folder"
                )
            owner[name.lower()] = file


def build_spec(file: Path, spec: Spec, out: Path) -> None:
    """Build and validate the two FMUs of a spec, and enter them in the manifest."""
    for fmu in (spec.plant, spec.controller):
        path = build(fmu, spec, ROOT / "fmu_src", out)
        validate(path)
        update_manifest(out / "manifest.json", path, fmu, file.stem)
        print(path)


if __name__ == "__main__":
    sys.exit(main())
