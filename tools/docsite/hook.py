"""Events of MkDocs: adds the generated pages and pictures, inserts facts of contact models, and converts
formulas.

Numbers of publications (DOI), and keys, commands and classes in code (`reference_links`) become links. CHANGELOG.md and the page of the benchmark are copied from their places in the
repository. A page contains `<!-- contact model NAME -->` or `<!-- contact models -->` where facts of the registry belong,
and `<!-- import tables -->` where those of the importer belong.
"""

import html
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs" / "pages"
sys.path.insert(0, str(ROOT / "tools"))

from docsite import (  # noqa: E402
    api_page,
    command_page,
    gallery,
    import_tables,
    model_pages,
    model_pictures,
    notebook_pages,
    quantity_pages,
    reference_links,
    scene_reference,
)

PAGES: Mapping[str, Callable[[], str]] = {
    "reference/commands.md": command_page.page,
    "reference/timeseries.md": quantity_pages.time_series,
    "reference/vtu.md": quantity_pages.vtu_arrays,
    "reference/metrics.md": quantity_pages.metrics,
    "reference/result.md": quantity_pages.result,
    "reference/units.md": quantity_pages.units,
    "reference/presets.md": quantity_pages.presets,
    "reference/python.md": api_page.page,
    "reference/python_blocks.md": api_page.blocks_page,
    "gallery.md": gallery.page,
}
"""Generated pages by path."""
COPIES: Mapping[str, str] = {"changelog.md": "CHANGELOG.md", "benchmark.md": "tools/benchmark/README.md"}
"""Pages that are files of the repository, by path."""
PICTURE = "assets/scaling.svg"
"""Path of the picture of the benchmark in the site."""
LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!https?:|#)([^)#\s]+)(#[^)\s]*)?\)")
DOI = re.compile(r"(?<![\w/\[(])10\.\d{4,9}/[^\s|\]>,;`]*[\w)]")
COMMIT = re.compile(r", commit [0-9a-f]{7,40}\b")
FENCE = re.compile(r"(^```.*?^```|`[^`\n]+`)", re.DOTALL | re.MULTILINE)
MODEL = re.compile(r"<!-- contact model (\w+) -->")
MODELS = "<!-- contact models -->"
BOLD_GREEK = re.compile(r'<mi mathvariant="bold-italic">&#x(003[BC][0-9A-F]);</mi>')
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_files(files: Any, config: Any) -> Any:
    """Add the generated pages and pictures. Raises PluginError for a contact model without a page."""
    from mkdocs.exceptions import PluginError
    from mkdocs.structure.files import File, InclusionLevel

    for path, page in PAGES.items():
        files.append(File.generated(config, path, content=page()))
    for name, text in scene_reference.pages().items():
        files.append(File.generated(config, f"reference/{name}.md", content=text))
    for name, text in api_page.class_pages().items():
        inclusion = InclusionLevel.NOT_IN_NAV
        path = f"reference/python/{name}.md"
        files.append(File.generated(config, path, content=text, inclusion=inclusion))
    for path, source in COPIES.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, path, content=copied(text, ROOT / source)))
    picture_source = str(ROOT / "tools" / "benchmark" / "scaling.svg")
    files.append(File.generated(config, PICTURE, abs_src_path=picture_source))
    for name in notebook_pages.names():
        files.append(File.generated(config, f"notebooks/{name}.md", content=notebook_pages.page(name)))
        source = str(notebook_pages.path_of(name))
        files.append(File.generated(config, f"notebooks/{name}.ipynb", abs_src_path=source))
    for name in model_pages.names():
        path = f"contact_models/{name}.md"
        if files.get_file_from_path(path) is None:
            raise PluginError(f"the contact model {name} has no page docs/pages/{path}")
        slot, _ = model_pages.find(name)
        picture = model_pictures.picture(slot, name)
        files.append(File.generated(config, f"assets/models/{name}.svg", content=picture))
    return files


def copied(text: str, source: Path) -> str:
    """The text of a file of the repository for a page at the top of the site: links to pages stay links, others are text."""

    def target(found: re.Match[str]) -> str:
        is_picture, label, path, part = found[1], found[2], found[3], found[4] or ""
        file = (source.parent / path).resolve()
        if is_picture:
            return f"![{label}]({PICTURE})"
        if file.is_relative_to(DOCS) and file.suffix == ".md":
            return f"[{label}]({file.relative_to(DOCS).as_posix()}{part})"
        return label

    return LINK.sub(target, text)


def with_links(markdown: str) -> str:
    """The text with links from the numbers of publications, except in code."""
    parts = FENCE.split(markdown)
    parts[::2] = [DOI.sub(_doi_link, part) for part in parts[::2]]
    return "".join(parts)


def _doi_link(found: re.Match[str]) -> str:
    """A link; a closing parenthesis belongs to the number if it contains the opening one."""
    number, rest = found[0], ""
    if number.endswith(")") and "(" not in number:
        number, rest = number[:-1], ")"
    return f"[{number}](https://doi.org/{number}){rest}"


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Insert the facts of contact models. Raises PluginError if the page of a model does not contain its
    facts."""
    from mkdocs.exceptions import PluginError

    path = Path(page.file.src_uri)
    if path.parent.name == "contact_models" and path.stem in set(model_pages.names()):
        if MODEL.findall(markdown) != [path.stem]:
            raise PluginError(f"docs/pages/{path} must contain <!-- contact model {path.stem} --> once")
    markdown = MODEL.sub(lambda found: model_pages.facts(found[1]), markdown)
    if import_tables.MARK in markdown:
        markdown = markdown.replace(import_tables.MARK, import_tables.tables())
    markdown = COMMIT.sub("", markdown.replace(MODELS, model_pages.overview()))
    return with_links(reference_links.linked(markdown, page.file.src_uri))


def on_page_content(content: str, page: Any, config: Any, files: Any) -> str:
    """Convert formulas to MathML, which browsers draw without a script."""
    return FORMULA.sub(lambda found: mathml(found[3], is_block=found[2] == "["), content)


def mathml(formula: str, is_block: bool) -> str:
    """MathML of a LaTeX formula; bold letters are characters, because browsers ignore the attribute."""
    from latex2mathml.converter import convert

    latex = re.sub(r"\\mathbf ([A-Za-z])", r"\\mathbf{\1}", html.unescape(formula).strip())
    converted = BOLD_GREEK.sub(_bold, str(convert(latex, display="block" if is_block else "inline")))
    return f'<div class="formula">{converted}</div>' if is_block else converted


def _bold(found: re.Match[str]) -> str:
    """A Greek letter as the bold italic mathematical character."""
    return f"<mi>&#x{int(found[1], 16) - 0x03B1 + 0x1D736:X};</mi>"
