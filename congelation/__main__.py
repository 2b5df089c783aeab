"""``python -m congelation`` is the command ``congelation``."""

from congelation.cli import main

__all__: list[str] = []

if __name__ == "__main__":
    main()
