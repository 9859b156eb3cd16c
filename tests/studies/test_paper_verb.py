"""`granflow paper` on the command line: an error message without the plot extra, a self-contained page with
it."""

import re
import sys

import pytest

from granflow.cli.main import main


def test_missing_matplotlib_is_reported_with_the_install_command(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["paper", "--out", str(tmp_path / "paper")]) == 2
    message = capsys.readouterr().err
    assert "pip install matplotlib" in message and "Traceback" not in message
    assert not (tmp_path / "paper").exists()


@pytest.mark.slow
def test_page_contains_every_figure(taichi_f64, tmp_path):
    pytest.importorskip("matplotlib")
    from granflow.studies.paper import report

    page = report.write_paper(tmp_path)
    figures = sorted(path.stem for path in tmp_path.glob("*.png"))
    assert figures == sorted(path.stem for path in tmp_path.glob("*.csv"))
    assert len(figures) == 9
    html = page.read_text(encoding="utf-8")
    assert html.count("data:image/png;base64,") == len(figures)
    sources = re.findall(r'(?:src|href)="([^"]*)"', html)
    assert not [source for source in sources if source.startswith(("http", "//"))]
    assert "not compared" not in html
