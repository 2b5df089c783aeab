"""Co-simulation of FMI 2.0 units: describe a system, couple it, run it.

System, Component, Connection     what is coupled; loads no binary
simulate                          the master
COUPLINGS, make_coupling          how inputs move between communication points
Result, Status, Statistics        what a run leaves behind
Output, Memory, ParquetFile       which rows are kept, and where
SlavePool                         instances kept from one run to the next
"""

from congelation.cosim.coupling import COUPLINGS, Coupling, make_coupling
from congelation.cosim.master import simulate
from congelation.cosim.output import Output
from congelation.cosim.pool import SlavePool
from congelation.cosim.recorder import Memory, ParquetFile, Sink
from congelation.cosim.result import Result, Statistics, Status
from congelation.cosim.system import Component, Connection, System

__all__ = [
    "COUPLINGS",
    "Component",
    "Connection",
    "Coupling",
    "Memory",
    "Output",
    "ParquetFile",
    "Result",
    "Sink",
    "SlavePool",
    "Statistics",
    "Status",
    "System",
    "make_coupling",
    "simulate",
]
