"""HTML pages of studies: one self-contained file, with escaped text."""

import re
from html.parser import HTMLParser
from importlib.resources import files

import numpy as np
import pytest
from jinja2 import UndefinedError

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
        "lead": "Lead.",
        "text": "Text <i>\u202e.",
        "content": TABLE,
        "figures": {name: 44.1},
        "folder": folder,
    }
    return page_text(environment().from_string(TEMPLATE), **{"name": name} | defaults | content)


def test_html_is_balanced_and_escaped(tmp_path):
    parser = BalanceParser()
    parser.feed(page_with(tmp_path))
    assert not parser.open
    text = "".join(parser.text)
    assert "Text <i>\\u202e." in text and "a < b" in text and "A & B" in text


def test_contents_list_links_to_every_section(tmp_path):
    html = page_with(tmp_path)
    assert re.findall(r'<a href="#(\w+)">(.*?)</a>', html) == [
        ("section1", "First &lt;1&gt;"),
        ("section2", "Second"),
    ]
    assert re.findall(r'<section id="(\w+)">', html) == ["section1", "section2"]


def test_page_refers_to_no_external_files(tmp_path):
    sources = re.findall(r'(?:src|href)="([^"]*)"', page_with(tmp_path))
    assert sources and not [source for source in sources if "//" in source]
    assert sources.count("data:image/png;base64,iVBORw0KGgo=") == 2
    assert [source for source in sources if source.startswith("a.")] == ["a.png", "a.csv"]


def test_figures_that_were_not_drawn_are_omitted(tmp_path):
    assert page_with(tmp_path).count("<img") == 2
    html = page_with(tmp_path, figures={})
    assert html.count("<img") == 1 and "seen" not in html


def test_figures_fill_narrow_screens_only(tmp_path):
    assert page_with(tmp_path).count('style="max-width: 44.1rem"') == 1, "embedded images fill every screen"


def test_caption_without_elements_is_the_alternative_text(tmp_path):
    assert 'alt="seen &amp; drawn"' in page_with(tmp_path)


def test_text_cells_have_the_class_words(tmp_path):
    assert "<td class=words>a &lt; b</td><td>0.5</td>" in page_with(tmp_path)


def test_tables_have_the_caption_of_the_call_or_their_own(tmp_path):
    assert re.findall("<caption>(.*)</caption>", page_with(tmp_path)) == ["numbers", "its own caption"]


def test_rows_of_wide_tables_are_labeled_for_narrow_screens(tmp_path):
    wide = PageTable(("law", "a", "b", "c<", "d"), [("x", "1", "2", "3", "4")])
    page = page_with(tmp_path, content=wide)
    assert "<table class=cards>" in page and '<td data-label="c&lt;">3</td>' in page
    assert '<td class=words data-label="law">x</td>' in page
    long = PageTable(("time", "level", "message"), [("0", "error", "long " * 13)])
    assert "<table class=cards>" in page_with(tmp_path, content=long)
    narrow = page_with(tmp_path)
    assert "class=cards" not in narrow and "data-label=" not in narrow.partition("</style>")[2]


def test_styles_of_narrow_screens_follow_the_styles_that_they_replace():
    style = (files("granflow.studies") / "templates" / "style.css").read_text()
    wide, mark, narrow = style.partition("@media (max-width")
    assert mark and all(
        f"{selector} {{" in wide for selector in (".gallery figure", "td.words", "body", "nav", "pre")
    )
    assert narrow.count("{") == narrow.count("}") and ".gallery figure { width: 100%" in narrow


def test_films_are_embedded_as_video(tmp_path):
    assert '<video controls loop muted src="data:video/mp4;base64,' in page_with(tmp_path, "a.mp4")


def test_unsupported_image_formats_raise(tmp_path):
    with pytest.raises(KeyError):
        page_with(tmp_path, "a.gif")


def test_undefined_variables_raise(tmp_path):
    with pytest.raises(UndefinedError, match="'study' is undefined"):
        write_study(tmp_path / "page.html", "accuracy.html", {}, {})


def test_all_templates_are_package_data_and_compile():
    names = {path.name for path in files("granflow.studies").joinpath("templates").iterdir()}
    assert (
        {"page.html", "macros.html", "style.css", "report.html"}
        <= names
        == set(environment().list_templates())
    )
    for name in names:
        environment().get_template(name)


def test_study_files_are_written_to_a_new_directory(tmp_path):
    pytest.importorskip("matplotlib")
    out = tmp_path / "a" / "b"
    content = {
        "headline": "h",
        "accurate": 0.01,
        "silent_limit": 0.5,
        "summary": PageTable((), ()),
        "families": (),
    }
    figures = {"stability.png": Drawing(lambda figure: figure.subplots(), 1.0)}
    assert not write_study(
        out / "p.html", "stability.html", {"t.csv": {"x": np.array([0.1])}}, figures, **content
    )
    assert (out / "t.csv").read_text() == "x\n0.1\n"
    html = (out / "p.html").read_text(encoding="utf-8")
    assert (
        "max-width: 44.1rem" in html
        and "data:image/png;base64," in html
        and "up to 1 %;" in html
        and "above 50 % without" in html
    )


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.0, "0 %"), (1e-7, "1e−05 %"), (0.00123, "0.12 %"), (0.0996, "10 %"), (1.5, "150 %")],
)
def test_percent_has_two_digits(share, text):
    assert percent(share) == text
