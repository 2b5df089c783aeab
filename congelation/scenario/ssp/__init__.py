"""Scenarios as archives of the SSP 1.0 standard (System Structure and Parameterization).

read_ssp    an archive in, a `Scenario` out
write_ssp   one variant of a scenario out, with its FMUs inside

References
----------
Modelica Association, System Structure and Parameterization 1.0, 2019.
"""

from congelation.scenario.ssp.read import read_ssp
from congelation.scenario.ssp.write import write_ssp

__all__ = ["read_ssp", "write_ssp"]
