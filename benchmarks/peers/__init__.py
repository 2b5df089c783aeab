"""The compiled loop and native FMUs against other programs: ``python -m benchmarks.peers``."""
