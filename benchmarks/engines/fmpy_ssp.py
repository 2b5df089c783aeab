"""FMPy's `simulate_ssp`."""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from fmpy.ssp import simulation
from fmpy.ssp.ssd import Parameter, ParameterSet

from benchmarks.engines.base import Engine, Run
from benchmarks.loop import Loop
from benchmarks.timing import Stopwatch

__all__ = ["FmpySsp"]

_SSD = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription version="1.0" name="Loop"
  xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
  xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription">
 <ssd:System name="loop">
  <ssd:Elements>{components}
  </ssd:Elements>
  <ssd:Connections>{connections}
  </ssd:Connections>
 </ssd:System>
</ssd:SystemStructureDescription>
"""
_COMPONENT = """
   <ssd:Component name={name} type="application/x-fmu-sharedlibrary" source={source}>
    <ssd:Connectors>{connectors}
    </ssd:Connectors>
   </ssd:Component>"""
_CONNECTOR = """
     <ssd:Connector name={name} kind="{kind}"><ssc:Real/></ssd:Connector>"""
_CONNECTION = """
   <ssd:Connection startElement={a} startConnector={y} endElement={b} endConnector={u}/>"""


class FmpySsp(Engine):
    """Jacobi from zero inputs; the row labelled t holds the outputs at t + h."""

    def __init__(self, loop: Loop) -> None:
        super().__init__(loop)
        self._folder = tempfile.TemporaryDirectory()
        self._file = Path(self._folder.name) / "loop.ssp"
        _write_ssp(loop, self._file)
        values = {f"{c.name}.{name}": v for c in loop.components for name, v in c.start.items()}
        self._parameters = ParameterSet(
            name="start", parameters=[Parameter(name=n, value=v) for n, v in values.items()]
        )

    def run(self, steps: int, step: float, *, keep_rows: bool) -> Run:
        """Rows are recorded in any case; loading is left out of the time."""
        # It goes on while time < stop_time, time being a sum of steps.
        stop = (steps - 0.5) * step
        with _stepping_timed() as seconds:
            table = simulation.simulate_ssp(
                str(self._file), stop_time=stop, step_size=step, parameter_set=self._parameters
            )
        if not keep_rows:
            return Run(seconds())
        columns = [table[f"{owner}.{name}"] for owner, name in self.loop.record]
        return Run(
            seconds(),
            [[(n + 1) * step, *(float(c[n]) for c in columns)] for n in range(len(table))],
        )


@contextmanager
def _stepping_timed() -> Iterator[Callable[[], float]]:
    """The time between the last instantiation and the first release inside `simulate_ssp`."""
    watches: list[Stopwatch] = []
    seconds: list[float] = []
    make, free = simulation.instantiate_fmu, simulation.free_fmu

    def instantiate_fmu(*args: Any, **kwargs: Any) -> None:
        make(*args, **kwargs)
        watches.append(Stopwatch())

    def free_fmu(*args: Any) -> None:
        seconds.append(watches[-1].seconds())
        free(*args)

    simulation.instantiate_fmu, simulation.free_fmu = instantiate_fmu, free_fmu
    try:
        yield lambda: seconds[0]
    finally:
        simulation.instantiate_fmu, simulation.free_fmu = make, free


def _write_ssp(loop: Loop, file: Path) -> None:
    components = []
    for component in loop.components:
        names = [(n, "input") for n in loop.inputs(component.name)]
        names += [(n, "output") for n in loop.outputs(component.name)]
        connectors = "".join(_CONNECTOR.format(name=quoteattr(n), kind=k) for n, k in names)
        components.append(
            _COMPONENT.format(
                name=quoteattr(component.name),
                source=quoteattr(f"resources/{Path(component.fmu).name}"),
                connectors=connectors,
            )
        )
    connections = [
        _CONNECTION.format(a=quoteattr(a), y=quoteattr(y), b=quoteattr(b), u=quoteattr(u))
        for a, y, b, u in loop.connections
    ]
    text = _SSD.format(components="".join(components), connections="".join(connections))
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("SystemStructure.ssd", text)
        for component in loop.components:
            archive.write(component.fmu, f"resources/{Path(component.fmu).name}")
