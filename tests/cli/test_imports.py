"""Verbs that do not simulate import neither Taichi nor large libraries, which would delay each of them."""

import subprocess
import sys

import pytest

HEAVY = {
    "taichi",
    "scipy",
    "meshio",
    "rich",
    "jinja2",
    "pandas",
    "matplotlib",
    "pyvista",
    "psutil",
    "platformdirs",
}
"""Packages that reading and checking a scene does not require."""

READS_SCENES = {"numpy", "pydantic", "ruamel"}
"""Packages that `--help` does not require either."""

PROGRAM = """
import sys
from granflow.cli.main import main
try:
    code = main(sys.argv[1:])
except SystemExit as end:
    code = end.code
print("imported:", *sorted({name.partition(".")[0] for name in sys.modules}))
sys.exit(code)
"""


def imported(root, *arguments):
    """Top-level packages that a verb imports in a process of its own."""
    command = [sys.executable, "-c", PROGRAM, *arguments]
    process = subprocess.run(command, cwd=root, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    return set(process.stdout.splitlines()[-1].split()[1:])


@pytest.mark.parametrize("scene", ["two_spheres", "hopper", "drum"])
def test_check_imports_no_heavy_library(pytestconfig, scene):
    packages = imported(pytestconfig.rootpath, "check", f"scenes/{scene}.yaml")
    assert packages >= READS_SCENES
    assert not packages & HEAVY


def test_help_imports_no_library(pytestconfig):
    assert not imported(pytestconfig.rootpath, "--help") & (HEAVY | READS_SCENES)


def test_simulation_imports_no_table_or_mesh_library(pytestconfig):
    program = (
        "import sys, granflow.simulation; print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    )
    process = subprocess.run(
        [sys.executable, "-c", program], cwd=pytestconfig.rootpath, capture_output=True, text=True
    )
    packages = set(process.stdout.split())
    assert "taichi" in packages
    assert not packages & {"scipy", "meshio", "jinja2", "pandas", "matplotlib", "pyvista"}
