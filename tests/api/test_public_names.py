"""Public names: static types, docstrings with examples that run, the guide."""

import ast
import doctest
import inspect
import re
import shutil
from pathlib import Path

import pytest

import granflow as gf

ROOT = Path(__file__).resolve().parents[2]
WITHOUT_EXAMPLE = {
    "FunctionError", "ParticleForce", "Simulation", "analyze_snapshots", "calibrate", "on_interval",
    "register_contact_model", "register_metric", "register_particle_equation", "start", "sweep",
}  # fmt: skip
"""Names that compile kernels, run sweeps or read measurements: pages of the documentation show them."""


def exported():
    """Public names with a docstring that has an example."""
    return [name for name in gf.__all__ if name not in WITHOUT_EXAMPLE]


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


def test_static_types_know_every_public_name():
    """Names are imported from where type checkers find them."""
    tree = ast.parse(Path(gf.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    imports = {each.asname: f"{node.module}.{each.name}" for node in block.body for each in node.names}
    assert imports == gf._LOCATIONS
    assert list(gf._LOCATIONS) == sorted(gf._LOCATIONS)
    assert (Path(gf.__file__).parent / "py.typed").exists()


@pytest.mark.parametrize("name", gf.__all__)
def test_public_functions_are_annotated(name):
    thing = getattr(gf, name)
    members = (
        [thing] if inspect.isfunction(thing) else [v for v in vars(thing).values() if inspect.isfunction(v)]
    )
    for function in members:
        if function.__module__.startswith("granflow") and not function.__name__.startswith("_"):
            signature = inspect.signature(function)
            parameters = [p for p in signature.parameters.values() if p.name not in ("self", "cls")]
            assert signature.return_annotation is not inspect.Signature.empty, function
            assert all(p.annotation is not inspect.Parameter.empty for p in parameters), function


@pytest.mark.parametrize("name", exported())
def test_example_in_the_docstring_runs(name, folder, monkeypatch):
    monkeypatch.chdir(folder)
    thing = getattr(gf, name)
    found = [
        test
        for test in doctest.DocTestFinder(recurse=False).find(thing, name, globs={"gf": gf})
        if test.examples
    ]
    assert found, f"{name} has no example"
    report = []
    assert not doctest.DocTestRunner().run(found[0], out=report.append).failed, "".join(report)


def test_examples_of_other_classes_run(folder, monkeypatch):
    monkeypatch.chdir(folder)
    run = gf.read_run("out/two")
    for thing in (type(run.frames), type(run.timeseries_arrays), gf.Scene.save):
        (test,) = doctest.DocTestFinder(recurse=False).find(thing, thing.__name__, globs={"gf": gf})
        report = []
        assert test.examples and not doctest.DocTestRunner().run(test, out=report.append).failed, "".join(
            report
        )


def test_examples_are_not_in_the_schema_of_files():
    from granflow.scene.reference import json_schema

    assert ">>>" in (gf.Cylinder.__doc__ or "") and ">>>" not in str(json_schema())


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
