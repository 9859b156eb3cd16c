"""HTML pages of studies: one self-contained file, with escaped text."""

import re
from html.parser import HTMLParser
from importlib.resources import files

import numpy as np
import pytest

from granflow.studies.figures import Drawing, PageTable, percent
from granflow.studies.page import environment, page_text, write_study

TINY = bytes.fromhex("89504e470d0a1a0a")
TABLE = PageTable(("law", "e"), [("a < b", "0.5"), ("c", "−1")], "its own caption")
TEMPLATE = """\
{% extends "page.html" %}
{% from "macros.html" import section, table, figure, image with context %}
{% block title %}A & B{% endblock %}
{% block lead %}{{ lead }}{% endblock %}
{% block sections %}
{% call section("First <1>") %}
<p>{{ text }}</p>
{% call table(content) %}numbers{% endcall %}
{% call figure(name, "a.csv") %}<b>seen</b> & drawn{% endcall %}
{% endcall %}
{% call section("Second") %}{{ table(content) }}{{ image(folder / name, "alone") }}{% endcall %}
{% endblock %}
"""


class BalanceParser(HTMLParser):
    """Tracks the open elements and collects the text."""

    def __init__(self):
        super().__init__()
        self.open = []
        self.text = []

    def handle_starttag(self, tag, attributes):
        if tag not in {"meta", "img"}:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def page_with(folder, name="a.png", **content):
    (folder / name).write_bytes(TINY)
    defaults = {
        "lead": "Lead.", "text": "Text <i>\x1b.", "content": TABLE, "figures": {name: 44.1},
        "folder": folder
    }  # fmt: skip
    return page_text(environment().from_string(TEMPLATE), **{"name": name} | defaults | content)


def test_html_is_balanced_escaped_and_refers_to_no_external_files(tmp_path):
    html = page_with(tmp_path)
    parser = BalanceParser()
    parser.feed(html)
    assert not parser.open
    text = "".join(parser.text)
    assert "Text <i>\\x1b." in text and "a < b" in text and "A & B" in text
    sources = re.findall(r'(?:src|href)="([^"]*)"', html)
    assert sources and not [source for source in sources if "//" in source]
    assert sources.count("data:image/png;base64,iVBORw0KGgo=") == 2
    assert [source for source in sources if source.startswith("a.")] == ["a.png", "a.csv"]


def test_all_templates_are_package_data_and_compile():
    names = {path.name for path in files("granflow.studies").joinpath("templates").iterdir()}
    assert {"page.html", "macros.html", "style.css", "report.html"} <= names
    assert names == set(environment().list_templates())
    for name in names:
        environment().get_template(name)


def test_study_files_are_written_to_a_new_directory(tmp_path):
    pytest.importorskip("matplotlib")
    out = tmp_path / "a" / "b"
    content = {
        "headline": "h", "accurate": 0.01, "silent_limit": 0.5, "summary": PageTable((), ()), "families": ()
    }  # fmt: skip
    figures = {"stability.png": Drawing(lambda figure: figure.subplots(), 1.0)}
    assert not write_study(
        out / "p.html", "stability.html", {"t.csv": {"x": np.array([0.1])}}, figures, **content
    )
    assert (out / "t.csv").read_text() == "x\n0.1\n"
    html = (out / "p.html").read_text(encoding="utf-8")
    for text in ("max-width: 44.1rem", "data:image/png;base64,", "up to 1 %;", "above 50 % without"):
        assert text in html


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.0, "0 %"), (1e-7, "1e−05 %"), (0.00123, "0.12 %"), (0.0996, "10 %"), (1.5, "150 %")],
)
def test_percent_has_two_digits(share, text):
    assert percent(share) == text
