"""`congelation build` for a checkout: without arguments, the FMUs of the paper's examples.

python build_fmu.py                       the FMUs of the standard specs, into fmus/
python build_fmu.py --spec FILE.toml      the plant and the controller of one spec
python build_fmu.py --native              the native twins, into fmus/native/
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

try:
    from congelation.cli import main as congelation
except ModuleNotFoundError as missing:
    sys.exit(
        f"build_fmu.py: this Python ({sys.executable}) has no module '{missing.name}'; "
        "run `make fmus`, which installs everything into .venv, or `. .venv/bin/activate` first"
    )

ROOT = Path(__file__).resolve().parent
# One spec for each form, and for each scenario of scenarios/ that has FMUs of its own.
STANDARD = (
    "scalar",
    "matched_pendulum",
    "state_feedback",
    "output_feedback",
    "reference",
    "disturbance",
    "noise",
    "noise2",
    "saturation",
    "lag",
    "delay",
    "active_suspension",
    "stable_zero3",
    "tracking",
    "varying_gain",
    "unknown_radius",
    "nonlinear",
    "bound_estimator",
    "filtered_transformation",
    "structured",
    "disturbance2",
    "disturbed",
    "disturbed_output",
    "tracking_radius",
    "tracking_bound",
    "tracking_structured",
    "wing_rock",
    "pendulum_length",
    "dc_motor",
    "f16_pitch",
)


def main(arguments: list[str] | None = None) -> None:
    """Build, and exit as `congelation build` does."""
    parser = argparse.ArgumentParser(description="Build FMUs from specs.")
    parser.add_argument("--spec", action="append", help="a spec; may be repeated")
    parser.add_argument("--out", default=str(ROOT / "fmus"), help="where to write them")
    parser.add_argument("--native", action="store_true", help="their native twins instead")
    options = parser.parse_args(arguments)
    specs = options.spec or [str(ROOT / "specs" / f"{name}.toml") for name in STANDARD]
    native = ["--native"] if options.native else []
    congelation(["build", *specs, "--out", options.out, *native])


if __name__ == "__main__":
    main()
