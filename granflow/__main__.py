"""`python -m granflow` and the command `granflow`: starts the command line."""

import sys


def main() -> int:
    """Run the command line and return its exit code.

    Ctrl-C during the imports ends it without a traceback.
    """
    try:
        from granflow.cli.main import main as run
    except KeyboardInterrupt:
        return 130
    return run()


if __name__ == "__main__":
    sys.exit(main())
