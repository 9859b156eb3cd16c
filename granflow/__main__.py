"""`python -m granflow` and the command `granflow`: starts the command line."""

import sys


def main() -> int:
    """Run the command line; Ctrl-C while it is still being imported ends without a traceback."""
    try:
        from granflow.cli import main as run
    except KeyboardInterrupt:
        return 130
    return run()


if __name__ == "__main__":
    sys.exit(main())
