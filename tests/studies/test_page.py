"""HTML page of a study: one self-contained file."""

import re
from html.parser import HTMLParser

import pytest

from granflow.studies.page import Page, PageTable, Picture, Section, html_of, write_page

TINY = bytes.fromhex("89504e470d0a1a0a")


class BalanceParser(HTMLParser):
    """Tracks the open elements and collects the text."""

    def __init__(self):
        super().__init__()
        self.open, self.text = [], []

    def handle_starttag(self, tag, attributes):
        if tag not in {"meta", "img"}:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture
def page(tmp_path):
    image = tmp_path / "a.png"
    image.write_bytes(TINY)
    table = PageTable("numbers", ("law", "e"), [("a < b", "0.5"), ("c", "−1")])
    return Page("A & B", "Lead.", [Section("First", ["Text <i>.", table, Picture(image, "seen", ("a.csv",))])])


def test_html_is_balanced_and_escaped(page):
    parser = BalanceParser()
    parser.feed(html_of(page))
    assert not parser.open
    text = "".join(parser.text)
    assert "Text <i>." in text and "a < b" in text and "A & B" in text


def test_page_refers_to_no_external_files(page, tmp_path):
    write_page(page, tmp_path / "page.html")
    html = (tmp_path / "page.html").read_text(encoding="utf-8")
    sources = re.findall(r'(?:src|href)="([^"]*)"', html)
    assert sources and not [source for source in sources if "//" in source]
    assert any(source.startswith("data:image/png;base64,iVBORw0KGgo=") for source in sources)


def test_text_cells_have_the_class_words(page):
    assert "<td class=words>a &lt; b</td><td>0.5</td>" in html_of(page)


def test_unsupported_image_formats_raise(page, tmp_path):
    (tmp_path / "a.gif").write_bytes(b"GIF")
    with pytest.raises(KeyError):
        html_of(Page("t", "l", [Section("s", [Picture(tmp_path / "a.gif", "c")])]))
