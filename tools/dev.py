"""Installs granflow into .venv next to pyproject.toml and runs it; requires only Python.

    python3 tools/dev.py run SCENE [arguments of granflow run]
    python3 tools/dev.py test [arguments of pytest]
    python3 tools/dev.py slow [arguments of pytest]      tests that take minutes
    python3 tools/dev.py gpu-test [arguments of pytest]  tests on Vulkan; prints the missing packages
    python3 tools/dev.py check                           lint, format, types, layers, vocabulary
    python3 tools/dev.py docs                            build the documentation site into out/site

The first call installs the versions pinned in constraints.txt, on Python 3.14 the latest ones; later calls
install nothing.
"""

import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ENVIRONMENT = ROOT / ".venv"
STAMP = ENVIRONMENT / "granflow-installed.txt"
UNFINISHED = "unfinished"
OLDEST, NEWEST = (3, 10), (3, 14)
NEWEST_PINNED = (3, 13)
"""Newest Python with the versions of constraints.txt; a newer one takes the latest of all packages."""
ALL = ("dev", "docs", "plot", "quadrants", "sweep", "cluster", "calibrate", "notebook")
EXTRAS = {
    "run": (),
    "test": ALL,
    "check": ("dev",),
    "slow": ALL,
    "gpu-test": ("dev", "quadrants"),
    "docs": ("docs", "plot"),
}


def main(arguments: "list[str]") -> int:
    """Runs one verb and returns its exit code; on POSIX the command of the verb replaces this process."""
    verb, rest = (arguments[0], arguments[1:]) if arguments else ("", [])
    if verb not in EXTRAS:
        print(__doc__.strip(), file=sys.stdout if verb in ("-h", "--help") else sys.stderr)
        return 0 if verb in ("-h", "--help") else 2
    refuse_what_cannot_work()
    install(EXTRAS[verb])
    return hand_over(command_of(verb, rest))


def command_of(verb: str, rest: "list[str]") -> "list[str]":
    """Command line of a verb, with the full path of its program."""
    commands = {
        "run": ["-m", "granflow", "run", *rest],
        "test": ["-m", "pytest", "-n", "auto", "--maxprocesses=4", "--dist", "worksteal", *rest],
        "slow": ["-m", "pytest", "-m", "slow", "--timeout=1800", *rest],
        "gpu-test": ["-m", "pytest", "-m", "gpu and not slow", "-rs", "tests/gpu", *rest],
        "check": [str(ROOT / "tools" / "check.py"), *rest],
        "docs": ["-m", "mkdocs", "build", "--strict", "--config-file", "docs/mkdocs.yml", *rest],
    }
    if verb != "run":
        os.chdir(str(ROOT))
    os.environ.setdefault("NO_MKDOCS_2_WARNING", "true")  # the versions are pinned below MkDocs 2
    return [str(environment_python()), *commands[verb]]


def hand_over(command: "list[str]") -> int:
    """Runs the command in this terminal, so that progress bars and Ctrl-C work."""
    sys.stdout.flush()
    if os.name == "posix":
        os.execv(command[0], command)
    try:
        return subprocess.call(command)
    except KeyboardInterrupt:
        return 130


def environment_python() -> Path:
    """Python interpreter of the virtual environment."""
    return ENVIRONMENT / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def refuse_what_cannot_work() -> None:
    """Stops with one sentence if this Python is not supported or .venv was made by another program."""
    version = sys.version_info[:2]
    if not OLDEST <= version <= NEWEST:
        available = [
            name for name in (f"python3.{minor}" for minor in range(13, 9, -1)) if shutil.which(name)
        ]
        remedy = "run this script with " + (available[0] if available else "one of these versions")
        span = f"{dotted(OLDEST)} to {dotted(NEWEST)}"
        stop(f"granflow needs Python {span}, but this is {dotted(version)}: {remedy}.")
    if ENVIRONMENT.exists() and any(ENVIRONMENT.iterdir()) and not STAMP.exists():
        stop(f"{ENVIRONMENT} was not made by tools/dev.py: move or remove it, then try again.")


def install(extras: "tuple[str, ...]") -> None:
    """Installs the requirements of pyproject.toml and constraints.txt unless they are installed."""
    python, inputs, installed = inputs_and_installed()
    usable = python in installed and environment_python().exists()
    if usable and {inputs, *extras} <= set(installed):
        return
    print(f"Setting up {ENVIRONMENT} (the first time takes a minute or two) ...", file=sys.stderr)
    kept = {extra for each in EXTRAS.values() for extra in each} & set(installed)
    extras = tuple(sorted({*extras, *kept}))
    if not usable:
        make_environment()
    STAMP.write_text(UNFINISHED + "\n")
    target = str(ROOT) + (f"[{','.join(extras)}]" if extras else "")
    pip = [str(environment_python()), "-m", "pip", "install", "--disable-pip-version-check"]
    pinned = ["-c", str(ROOT / "constraints.txt")] if sys.version_info[:2] <= NEWEST_PINNED else []
    if (
        extras
    ):  # most of their 12 000 modules are never imported; Python compiles the others at their first use
        pip.append("--no-compile")
    attempt(
        [*pip, *pinned, "-e", target],
        "Installing granflow failed (is this machine online?)",
    )
    STAMP.write_text("\n".join([python, inputs, *extras]) + "\n")


def inputs_and_installed() -> "tuple[str, str, list[str]]":
    """Python version and folder, digest of the requirement files, and the lines of the stamp file."""
    python = f"python {dotted(sys.version_info[:2])} in {ROOT}"
    digest = hashlib.sha256()
    for name in ("pyproject.toml", "constraints.txt"):
        digest.update((ROOT / name).read_bytes())
    installed = STAMP.read_text().splitlines() if STAMP.exists() else []
    return python, "inputs " + digest.hexdigest(), installed


def make_environment() -> None:
    """Makes a new virtual environment, marked unfinished until the installation is complete."""
    missing = [name for name in ("venv", "ensurepip") if importlib.util.find_spec(name) is None]
    if missing:
        stop(
            f"This Python lacks its module {missing[0]}: install it (on Debian and Ubuntu: "
            f"sudo apt install python{dotted(sys.version_info[:2])}-venv), then try again."
        )
    if ENVIRONMENT.is_symlink():
        stop(
            f"{ENVIRONMENT} is a link to the environment of another checkout: remove the link, then try "
            "again."
        )
    shutil.rmtree(str(ENVIRONMENT), ignore_errors=True)
    ENVIRONMENT.mkdir(exist_ok=True)
    STAMP.write_text(UNFINISHED + "\n")
    base = getattr(sys, "_base_executable", None) or sys.executable
    attempt([base, "-m", "venv", str(ENVIRONMENT)], "Making the virtual environment failed")


def attempt(command: "list[str]", failure: str) -> None:
    """Runs a command; if it fails, prints its output and stops."""
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    if done.returncode:
        sys.stderr.write(done.stdout.decode(errors="replace"))
        stop(f"{failure}: correct the error above, then repeat the command.")


def dotted(version: "tuple[int, int]") -> str:
    """3.10 for (3, 10)."""
    return ".".join(str(number) for number in version)


def stop(sentence: str) -> None:
    """Exits with a message and code 1."""
    sys.exit(f"tools/dev.py: {sentence}")


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit(130)
