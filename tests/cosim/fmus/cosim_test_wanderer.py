"""y = t, from an FMU that changes the working directory as it steps."""

import os
import tempfile

from cosim_test_base import Block


class TestWanderer(Block):
    output_names = ("y",)

    def outputs(self, t, x, u, du):
        return {"y": t}

    def do_step(self, current_time, step_size):
        os.chdir(tempfile.gettempdir())
        return super().do_step(current_time, step_size)
