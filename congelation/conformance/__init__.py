"""Rules of FMI 2.0 for co-simulation and model exchange, run against any FMU.

`congelation.conformance.runner.check` checks FMUs and returns a report, `report` renders it,
`rules.RULES` is the list of the rules. This package file imports nothing, because every rule
that runs a binary does so in a process of its own, which has to start fast.
"""

__all__: list[str] = []
