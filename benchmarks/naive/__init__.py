"""The pair that one writes first: numpy inside the FMUs, pythonfmu's defaults."""

__all__: list[str] = []
