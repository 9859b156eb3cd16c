"""Pages of the notebooks: their text and code without results, and the notebook as a file."""

import json
from pathlib import Path

NOTEBOOKS = Path(__file__).resolve().parents[2] / "docs" / "notebooks"
FILE = """\
[Open as a notebook]({name}.ipynb): `pip install ".[notebook]"` in the folder of the clone, and Jupyter or an editor for
notebooks. It is stored without results, which follow from the code; the tests execute it.
"""


def names() -> list[str]:
    """Names of the notebooks."""
    return sorted(path.stem for path in NOTEBOOKS.glob("*.ipynb"))


def path_of(name: str) -> Path:
    """The file of a notebook."""
    return NOTEBOOKS / f"{name}.ipynb"


def page(name: str) -> str:
    """The page of a notebook in Markdown: its title, the link to the file, text and code."""
    cells = json.loads(path_of(name).read_text(encoding="utf-8"))["cells"]
    title, *rest = [_markdown(cell["cell_type"], "".join(cell["source"])) for cell in cells]
    heading, _, introduction = title.partition("\n")
    return "\n\n".join([heading, introduction.strip(), FILE.format(name=name), *rest]) + "\n"


def _markdown(kind: str, text: str) -> str:
    """A cell in Markdown."""
    return f"```python\n{text}\n```" if kind == "code" else text
