"""The command line: `granflow VERB ...`; `main` returns the exit code."""

from granflow.cli.main import main

__all__ = ["main"]
