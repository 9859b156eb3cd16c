"""The start of commands: verbs that do not simulate import neither Taichi nor large libraries, and no garbage is
collected."""

import gc
import json
import subprocess
import sys
import weakref

import pytest

from granflow.cli.process import quick_start

HEAVY = {
    "taichi", "scipy", "meshio", "rich", "jinja2", "pandas", "matplotlib", "pyvista", "psutil", "platformdirs",
}  # fmt: skip
"""Packages that reading and checking a scene does not require."""

READS_SCENES = {"numpy", "pydantic", "ruamel"}
"""Packages that `--help` does not require either."""

PROGRAM = """
import contextlib, io, json, sys

def packages():
    return sorted({name.partition(".")[0] for name in sys.modules})

found = []
for arguments in json.loads(sys.argv[1]):
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            from granflow.cli.main import main
            code = main(arguments)
        except SystemExit as end:
            code = end.code or 0
    found.append([code, packages()])
import granflow.simulation
found.append([0, packages()])
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def imported(pytestconfig):
    """Exit code and imported packages after each verb in one process, and after the import of a simulation."""
    help_verbs = [["--help"], ["--version"], ["run", "--help"], ["collide", "--help"]]
    checks = [["check", f"scenes/{name}.yaml"] for name in ("two_spheres", "hopper", "drum")]
    checks.append([*checks[0], "--set", "run.duration=-1 s"])
    command = [sys.executable, "-c", PROGRAM, json.dumps([*help_verbs, *checks])]
    process = subprocess.run(command, cwd=pytestconfig.rootpath, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    found = [(code, set(packages)) for code, packages in json.loads(process.stdout.splitlines()[-1])]
    return found[: len(help_verbs)], found[len(help_verbs) : -1], found[-1]


def test_help_imports_no_library(imported):
    for code, packages in imported[0]:
        assert code == 0 and not packages & (HEAVY | READS_SCENES)


def test_check_imports_no_heavy_library_also_for_an_invalid_scene(imported):
    assert [code for code, _ in imported[1]] == [0, 0, 0, 2]
    for _, packages in imported[1]:
        assert packages >= READS_SCENES and not packages & HEAVY


def test_simulation_imports_no_table_or_mesh_library(imported):
    packages = imported[2][1]
    assert "taichi" in packages
    assert not packages & {"scipy", "meshio", "jinja2", "pandas", "matplotlib", "pyvista"}


@pytest.mark.parametrize("enabled", [True, False])
def test_garbage_collection_pauses_in_the_block(enabled):
    try:
        (gc.enable if enabled else gc.disable)()
        with pytest.raises(KeyError), quick_start():
            assert not gc.isenabled()
            raise KeyError
        assert gc.isenabled() == enabled
    finally:
        gc.enable()


class Cycle:
    """An object that refers to itself."""

    def __init__(self):
        self.itself = self


def test_objects_of_a_start_are_collected_late_but_not_never():
    """The next young collection does not search them; a full one still finds their cycles."""
    gc.unfreeze()  # what the tests have frozen
    try:
        with quick_start():
            lost = weakref.ref(Cycle())
            objects = [[] for _ in range(100_000)]
            assert gc.get_count()[0] > len(objects)
        assert gc.get_count()[0] < 1000 and not gc.get_freeze_count()
        gc.collect(0)
        assert lost() is not None
        gc.collect()
        assert lost() is None
    finally:
        gc.freeze()
