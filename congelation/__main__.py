"""``python -m congelation`` is the command ``congelation``."""

__all__ = ["main"]


def main() -> None:
    """Run the command line and exit."""
    # Here: a sweep's worker processes import the main module anew, and need nothing of this.
    from congelation.cli import main as command

    command()


if __name__ == "__main__":
    main()
