"""The command line: `granflow COMMAND ...`; `main` returns the exit code."""

from granflow.cli.main import main

__all__ = ["main"]
