"""The notebooks of the documentation: stored without results, executed by a Jupyter kernel."""

import json
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).resolve().parents[2] / "docs" / "notebooks").glob("*.ipynb"))
notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


@notebook
def test_notebook_is_stored_without_results(path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    results = [
        cell for cell in cells if cell["cell_type"] == "code" and (cell["outputs"] or cell["execution_count"])
    ]
    assert not results and cells[0]["cell_type"] == "markdown"


@pytest.mark.slow
@notebook
def test_notebook_runs(path, tmp_path):
    """The assertions of the notebook compare its results with theory; a failed one ends the execution with an
    error."""
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    found = nbformat.read(path, as_version=4)
    nbformat.validate(found)
    source = "\n".join(cell.source for cell in found.cells)
    assert "\nassert " in source or "\n    assert " in source
    nbclient.NotebookClient(found, timeout=900, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [output for cell in found.cells for output in cell.get("outputs", ())]
    assert any("image/png" in output.get("data", {}) for output in shown)
    assert not any(output.get("name") == "stderr" for output in shown), "a warning in a published notebook"
