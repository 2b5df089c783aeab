"""Copies what the package needs at run time but keeps at the top level into it when it is built,
and compiles the stepping loop."""

import os
import shutil
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_py import build_py

SHIPPED = ("fmu_src", "scenarios", "specs")


class BuildWithShipped(build_py):
    """In a wheel, congelation.places.shipped finds these folders inside of the package."""

    def run(self):
        super().run()
        # An editable installation finds them where they are.
        if self.editable_mode:
            return
        for name in SHIPPED:
            target = Path(self.build_lib) / "congelation" / "shipped" / name
            # An earlier build may have left files that are no more.
            shutil.rmtree(target, ignore_errors=True)
            shutil.copytree(name, target, ignore=shutil.ignore_patterns("__pycache__"))


# A plain shared library, called through ctypes; without a compiler the loop in Python runs. To have
# equal bits with that one, each operation is rounded by itself.
folder = Path("congelation/cosim/loop")
loop = Extension(
    "congelation.cosim.loop",
    [str(folder / "loop.c")],  # which includes the others
    depends=sorted(str(file) for file in folder.glob("*.[ch]")),
    extra_compile_args=[] if os.name == "nt" else ["-std=c99", "-O2", "-ffp-contract=off"],
    export_symbols=[
        "integrator_rates",
        "integrator_states",
        "loop_version",
        "run_adaptive",
        "run_dop853",
        "run_exchange",
        "run_held",
        "run_points",
        "work_size",
    ],
    optional=True,
)

setup(cmdclass={"build_py": BuildWithShipped}, ext_modules=[loop])
