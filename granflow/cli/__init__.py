"""The command line."""

from granflow.cli.main import main

__all__ = ["main"]
