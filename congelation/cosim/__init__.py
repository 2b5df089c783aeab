"""Co-simulation of FMI 2.0 units: describe a system, couple it, run it.

System, Component, Connection     what is coupled; loads no binary
simulate                          the master
Experiment, perform               the same as one value, and its run
Jacobi, GaussSeidel, Derivative,
Hermite, Sampled, ModelExchange   how inputs move between communication points
COUPLINGS, make_coupling          the same by name
Result, Status, Statistics        what a run leaves behind
Output, Memory, ParquetFile       which rows are kept, and where
SlavePool                         instances kept from one run to the next
"""

from congelation.cosim.coupling import (
    COUPLINGS,
    Coupling,
    Derivative,
    GaussSeidel,
    Hermite,
    Jacobi,
    ModelExchange,
    Sampled,
    make_coupling,
)
from congelation.cosim.experiment import Experiment
from congelation.cosim.master import perform, simulate
from congelation.cosim.pool import SlavePool
from congelation.cosim.recording import Output
from congelation.cosim.result import Result, Statistics, Status
from congelation.cosim.sinks import Memory, ParquetFile, Sink
from congelation.cosim.system import Component, Connection, System

__all__ = [
    "COUPLINGS",
    "Component",
    "Connection",
    "Coupling",
    "Derivative",
    "Experiment",
    "GaussSeidel",
    "Hermite",
    "Jacobi",
    "Memory",
    "ModelExchange",
    "Output",
    "ParquetFile",
    "Result",
    "Sampled",
    "Sink",
    "SlavePool",
    "Statistics",
    "Status",
    "System",
    "make_coupling",
    "perform",
    "simulate",
]
