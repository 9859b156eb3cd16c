"""Notebooks run from top to bottom: their code cells, executed in order in one namespace."""

import json
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).resolve().parents[2] / "docs" / "notebooks").glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, taichi_f64, tmp_path, monkeypatch):
    matplotlib = pytest.importorskip("matplotlib")
    pytest.importorskip("pandas")
    matplotlib.use("agg")
    monkeypatch.chdir(tmp_path)
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    names: dict = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            assert not cell["outputs"], "notebooks are stored without outputs"
            exec("".join(cell["source"]), names)
    if path.stem == "first_steps":
        weight, floor = names["weight"], names["floor"]["wall_force_z"]
        assert 0.4 * weight < -floor[-50:].mean() <= 1.02 * weight, "the floor carries most of the weight of the bed"
        assert names["run"].status == "complete" and len(names["run"].contacts[-1]["normal_force"]) > 200
    names["simulation"].free()
