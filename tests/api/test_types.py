"""Static types of the public names, as a type checker of a user sees them."""

import subprocess
import sys
from pathlib import Path

import pytest

import granflow as gf

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_programs_of_users_pass_a_strict_type_check(tmp_path):
    """`mypy --strict` with the plugin of pydantic; a wrong program has errors in each line, no public name is
    Any."""
    (tmp_path / "mypy.ini").write_text("[mypy]\nplugins = pydantic.mypy\nfollow_imports = silent\n")
    names = "\n".join(f"reveal_type(gf.{name})" for name in gf.__all__)
    (tmp_path / "names.py").write_text(f"from typing import reveal_type\nimport granflow as gf\n{names}\n")
    wrong = "gf.Scene.from_dict(1)\ngf.Plane(material='glass')\ngf.read_run(1)\ngf.Simulation('a.yaml')\n"
    (tmp_path / "wrong.py").write_text(f"import granflow as gf\n{wrong}")
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file", "mypy.ini", "--cache-dir", "cache"]
    programs = [Path(__file__).with_name("typed_program.py"), "names.py", "wrong.py"]
    environment = {"MYPYPATH": str(ROOT), "PATH": ""}
    done = subprocess.run(
        [*command, *programs], capture_output=True, text=True, cwd=tmp_path, env=environment
    )
    lines = done.stdout.splitlines()
    errors = {":".join(line.split(":")[:2]) for line in lines if ": error: " in line}
    assert errors == {f"wrong.py:{number}" for number in (2, 3, 4, 5)}, done.stdout
    revealed = [line for line in lines if "Revealed type" in line]
    assert len(revealed) == len(gf.__all__) and not any('is "Any"' in line for line in revealed), done.stdout
