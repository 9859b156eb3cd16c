"""Public names: lazy imports, static types, docstrings with examples that run, the guide."""

import ast
import doctest
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import granflow as gf

ROOT = Path(__file__).resolve().parents[2]
WITHOUT_EXAMPLE = {
    "FunctionError", "ParticleForce", "Simulation", "analyze_snapshots", "calibrate", "on_interval",
    "register_contact_model", "register_metric", "register_particle_equation", "start", "sweep",
}  # fmt: skip
"""Names that compile kernels, run sweeps or read measurements: pages of the documentation show them."""


@pytest.fixture(scope="module")
def folder(taichi_f64, tmp_path_factory):
    """A folder with the scenes two.yaml (README) and hopper.yaml, and the run out/two."""
    path = tmp_path_factory.mktemp("examples")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (path / "two.yaml").write_text(re.search(r"```yaml\n(.*?)```", readme, re.DOTALL)[1])
    shutil.copy(ROOT / "scenes" / "hopper.yaml", path)
    simulation = gf.Simulation(gf.load_scene(path / "two.yaml"), out=path / "out" / "two")
    simulation.run()
    assert repr(simulation).startswith('<Simulation "Two steel spheres": 0.02 s, step ')
    simulation.free()
    return path


def test_names_are_imported_at_first_use_from_where_type_checkers_find_them(folder):
    """Reading a scene or a run does not start Taichi."""
    tree = ast.parse(Path(gf.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    imports = {each.asname: f"{node.module}.{each.name}" for node in block.body for each in node.names}
    assert imports == gf._LOCATIONS and set(dir(gf)) == {*gf.__all__, "__version__"}
    assert all(getattr(gf, name).__name__ == name for name in gf.__all__)
    code = (
        "import sys, granflow; run = granflow.read_run(sys.argv[1]); run.scene, run.result, run.frames[-1];"
        "sys.exit('taichi' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code, folder / "out" / "two"]).returncode == 0


@pytest.mark.parametrize(
    "name", [name for name in gf.__all__ if name not in WITHOUT_EXAMPLE] + ["Scene.save"]
)
def test_example_in_the_docstring_runs(name, folder, monkeypatch):
    monkeypatch.chdir(folder)
    thing = gf.Scene.save if name == "Scene.save" else getattr(gf, name)
    (test,) = doctest.DocTestFinder(recurse=False).find(thing, name, globs={"gf": gf})
    report = []
    assert test.examples and not doctest.DocTestRunner().run(test, out=report.append).failed, "".join(report)


def test_guide_runs_as_one_script(taichi_f64, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    guide = (ROOT / "docs" / "pages" / "guides" / "scenes_in_python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", guide, re.DOTALL)
    names: dict = {}
    exec("\n".join(blocks), names)
    names["simulation"].free()
    printed = capsys.readouterr().out
    errors = next(block for block in blocks if "except gf.SceneError" in block)
    expected = [line.removeprefix("# ") for line in errors.splitlines() if line.startswith("# ")]
    assert len(expected) == 2 and "\n".join(expected) in printed
    assert gf.load_scene("beads.yaml") == names["scene"] and "complete" in printed
