"""Benchmarks: ``make bench``, or ``python -m benchmarks``; the tables go to docs/benchmarks.md."""

__all__: list[str] = []
