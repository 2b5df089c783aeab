"""A process in which one program lives: ``python -m benchmarks.worker MODULE``.

It reads one JSON object a line from its standard input and answers each with one line. What
programs print goes to the standard error output.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
from array import array
from typing import Any, TextIO

from benchmarks.loop import Loop

__all__ = ["serve"]


def serve(module: str, requests: TextIO, answers: TextIO) -> None:
    """Load the program, then run what is asked for until the input ends.

    The first line is the loop; each further one holds `settings`, the arguments of `run`, and
    `rows`, the path of a file for the rows as doubles, or null. A run that fails does not end the
    process.
    """
    found = importlib.import_module(f"benchmarks.engines.{module}")
    program = getattr(found, found.__all__[0])(Loop.from_json(requests.readline()))
    _answer(answers, {"ready": True})
    for line in requests:
        request = json.loads(line)
        file_name = request["rows"]
        try:
            run = program.run(**request["settings"], keep_rows=file_name is not None)
        except RuntimeError as error:
            _answer(answers, {"error": str(error)})
            continue
        if file_name is not None:
            with open(file_name, "wb") as file:
                array("d", [value for row in run.rows for value in row]).tofile(file)
        _answer(answers, {"seconds": run.seconds})


def _answer(stream: TextIO, message: dict[str, Any]) -> None:
    stream.write(json.dumps(message) + "\n")
    stream.flush()


if __name__ == "__main__":
    answers = os.fdopen(os.dup(1), "w")
    # Libraries print to descriptor 1, past sys.stdout.
    os.dup2(2, 1)
    try:
        serve(sys.argv[1], sys.stdin, answers)
    except Exception as error:
        _answer(answers, {"error": f"{type(error).__name__}: {error}"})
        raise
    # Several engines and FMUs crash a process that ends in the usual way.
    os._exit(0)
