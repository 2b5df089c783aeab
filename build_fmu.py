"""Build the FMUs: derive the equations, stage the sources, package, complete, validate, list.

python build_fmu.py                       every spec of specs/ that the paper's figures need
python build_fmu.py --spec FILE.toml      the plant and the controller of one spec
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from congelation.errors import CongelationError
from congelation.export.manifest import update_manifest
from congelation.export.package import build
from congelation.export.spec import read_spec
from congelation.export.validation import validate

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
        for file in files:
            build_spec(file, options.out)
    except CongelationError as error:
        print(f"build_fmu.py: {error}", file=sys.stderr)
        return 2
    return 0


def build_spec(file: Path, out: Path) -> None:
    """Build and validate the two FMUs of a spec, and enter them in the manifest."""
    spec = read_spec(file)
    for fmu in (spec.plant, spec.controller):
        path = build(fmu, spec, ROOT / "fmu_src", out)
        validate(path)
        update_manifest(out / "manifest.json", path, fmu, file.stem)
        print(path)


if __name__ == "__main__":
    sys.exit(main())
