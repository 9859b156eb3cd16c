"""Lint, format, types and layers in one go; run it as `python3 tools/dev.py check`.

Silent but for one closing line when all is well; otherwise shows what each failing check said and exits 1.
"""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CHECKS = {
    "lint": ["ruff", "check", "--quiet", "."],
    "format": ["ruff", "format", "--check", "--quiet", "."],
    "types": ["mypy", "--no-error-summary"],
    "layers": ["pytest", "-q", "--no-header", "tests/test_layers.py"],
}
REMEDIES = {"lint": "ruff check --fix .", "format": "ruff format ."}


def main() -> int:
    """Run every check, whatever the others say; 1 if any fails."""
    failed = [name for name in CHECKS if not passes(name)]
    print("check: " + ("failed: " + ", ".join(failed) if failed else ", ".join(CHECKS) + " are in order"))
    return 1 if failed else 0


def passes(name: str) -> bool:
    """Whether one check passes; its words are shown only if not."""
    done = subprocess.run(
        [sys.executable, "-m", *CHECKS[name]],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    if done.returncode:
        remedy = f" (mended by: {Path(sys.executable).parent / REMEDIES[name]})" if name in REMEDIES else ""
        print(f"--- {name}{remedy}\n{done.stdout}")
    return done.returncode == 0


if __name__ == "__main__":
    sys.exit(main())
