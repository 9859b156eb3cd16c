"""HTML pages of studies: one self-contained file, with escaped text."""

import re
from importlib.resources import files

from granflow.studies.figures import PageTable
from granflow.studies.page import environment, page_text

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
{% endblock %}
"""


def test_html_is_escaped_and_refers_to_no_external_files(tmp_path):
    (tmp_path / "a.png").write_bytes(bytes.fromhex("89504e470d0a1a0a"))
    table = PageTable(("law", "e"), [("a < b", "0.5"), ("c", "−1")], "its own caption")
    html = page_text(
        environment().from_string(TEMPLATE), name="a.png", lead="Lead.", text="Text <i>\x1b.", content=table,
        figures={"a.png": 44.1}, folder=tmp_path,
    )  # fmt: skip
    assert "Text &lt;i&gt;\\x1b." in html and "a &lt; b" in html
    sources = re.findall(r'(?:src|href)="([^"]*)"', html)
    assert "data:image/png;base64,iVBORw0KGgo=" in sources and not [each for each in sources if "//" in each]
    assert [source for source in sources if source.startswith("a.")] == ["a.png", "a.csv"]


def test_all_templates_are_package_data_and_compile():
    names = {path.name for path in files("granflow.studies").joinpath("templates").iterdir()}
    assert {"page.html", "report.html"} <= names == set(environment().list_templates())
    for name in names:
        environment().get_template(name)
