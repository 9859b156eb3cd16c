"""`python -m granflow`: the command line without its installed name."""

import sys

from granflow.cli import main

if __name__ == "__main__":
    sys.exit(main())
