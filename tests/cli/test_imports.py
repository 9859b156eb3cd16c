"""Verbs that do not simulate start without Taichi and large libraries."""

import json
import subprocess
import sys

READS_SCENES = {"numpy", "pydantic", "ruamel"}
HEAVY = {"taichi", "scipy", "meshio", "rich", "jinja2", "pandas", "matplotlib", "pyvista", "psutil"}
PROGRAM = """
import contextlib, io, json, sys
from granflow.cli.main import main
found = []
for arguments in (["run", "--help"], ["check", "scenes/hopper.yaml"]):
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        main(arguments)
    found.append([name.partition(".")[0] for name in sys.modules])
print(json.dumps(found))
"""


def test_help_and_check_import_no_large_library(pytestconfig):
    command = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(command, cwd=pytestconfig.rootpath, capture_output=True, text=True, check=True)
    of_help, of_check = map(set, json.loads(done.stdout))
    assert not of_help & (HEAVY | READS_SCENES)
    assert of_check >= READS_SCENES and not of_check & HEAVY
