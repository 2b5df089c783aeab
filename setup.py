"""Copies what the package needs at run time but keeps at the top level into it when it is built."""

import shutil
from pathlib import Path

from setuptools import setup
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


setup(cmdclass={"build_py": BuildWithShipped})
