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
    wrong = (
        "gf.Scene.from_dict(1)",
        "gf.Plane(material='glass')",
        "gf.read_run(1)",
        "gf.Simulation('a.yaml')",
    )
    (tmp_path / "wrong.py").write_text("\n".join(["import granflow as gf", *wrong]))
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file", tmp_path / "mypy.ini"]
    command += ["--cache-dir", tmp_path / "cache", Path(__file__).with_name("typed_program.py")]
    done = subprocess.run(
        [*command, tmp_path / "names.py", tmp_path / "wrong.py"],
        capture_output=True, text=True, cwd=tmp_path, env={"MYPYPATH": str(ROOT), "PATH": ""},
    )  # fmt: skip
    errors = [line for line in done.stdout.splitlines() if ": error: " in line]
    revealed = [line for line in done.stdout.splitlines() if "Revealed type" in line]
    assert {line.split(":")[0].rsplit("/")[-1] for line in errors} == {"wrong.py"}, done.stdout
    assert {int(line.split(":")[1]) for line in errors} == {2, 3, 4, 5}, done.stdout
    assert len(revealed) == len(gf.__all__) and not any('is "Any"' in line for line in revealed), done.stdout
