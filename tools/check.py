"""Checks of lint, format, types, layers and vocabulary; run as `python3 tools/dev.py check`.

Prints one line if all checks pass; otherwise prints the output of each failing check and exits with code 1.
"""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CHECKS = {
    "lint": ["-m", "ruff", "check", "--quiet", "."],
    "format": ["-m", "ruff", "format", "--check", "--quiet", "."],
    "types": ["-m", "mypy", "--no-error-summary"],
    "layers": ["-m", "pytest", "-q", "--no-header", "tests/test_layers.py"],
    "vocabulary": ["tools/banned_words.py"],
}
"""Arguments of Python for each check."""
REMEDIES = {"lint": "ruff check --fix .", "format": "ruff format ."}


def main() -> int:
    """Runs all checks; returns 1 if a check fails."""
    failed = [name for name in CHECKS if not passes(name)]
    print("check: " + ("failed: " + ", ".join(failed) if failed else ", ".join(CHECKS) + " are in order"))
    return 1 if failed else 0


def passes(name: str) -> bool:
    """Whether a check passes; prints its output if it fails."""
    done = subprocess.run(
        [sys.executable, *CHECKS[name]],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    if done.returncode:
        remedy = f" (fix: {Path(sys.executable).parent / REMEDIES[name]})" if name in REMEDIES else ""
        print(f"--- {name}{remedy}\n{done.stdout}")
    return done.returncode == 0


if __name__ == "__main__":
    sys.exit(main())
