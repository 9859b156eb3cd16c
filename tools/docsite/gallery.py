"""Gallery page: every shipped scene with picture, film, description, published values and command."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from scene_table import expected_and_run, stored_results

from docsite.markdown import code, table
from granflow.cli.run import scene_paths

ROOT = Path(__file__).resolve().parents[2]
SCENES, PICTURES = ROOT / "scenes", ROOT / "docs" / "pages" / "gallery"
COMPARISONS = ROOT / "docs" / "scenes_comparisons.yaml"
VERIFICATION = "verification"
"""Folder of the scenes with closed-form results, which have no pictures."""
INTRODUCTION = """\
# Gallery

Every scene is part of the package: `granflow examples` lists them, `granflow example hopper` copies one with its
meshes to the working directory, and `granflow run hopper.yaml` runs it. In a clone: `python3 tools/dev.py run
scenes/hopper.yaml`. The pictures and films are rendered by `granflow render`, colored by speed unless stated
otherwise; a film takes five seconds and states its speed relative to the simulated time. `granflow report` shows a run
in 3D.
[Published values](scenes.md) compares the results of the scenes with experiments and theory.
"""


def page() -> str:
    """The page in Markdown."""
    sections = [
        INTRODUCTION,
        _contents(),
        *(_section(name) for name in names() if not name.startswith(VERIFICATION)),
    ]
    rows = [(code(name), _scene(name)["title"]) for name in names() if name.startswith(VERIFICATION)]
    verification = (
        "## Verification scenes\n\nSingle collisions and small systems with closed-form or published "
        "results.\n\n"
    )
    return "\n".join([*sections, verification + table(("scene", "title"), rows)])


def names() -> list[str]:
    """Names of the shipped scenes, without sweeps and calibrations: paths relative to scenes/ without
    suffix."""
    return sorted(scene_paths())


def picture_of(name: str) -> Path:
    """Picture of a scene."""
    return PICTURES / f"{name.replace('/', '_')}.jpg"


def _contents() -> str:
    """Pictures of the scenes with links to their sections; tools/gallery_pictures.py renders them."""
    cells = []
    for name in names():
        if name.startswith(VERIFICATION) or not picture_of(name).exists():
            continue
        title = _scene(name)["title"]
        link = f"[![{title}](gallery/{picture_of(name).name})](#{_identifier(name)})"
        cells.append(f'<figure markdown="span">{link}<figcaption>{title}</figcaption></figure>')
    return '<div class="gallery" markdown="block">\n' + "\n".join(cells) + "\n</div>\n"


def _section(name: str) -> str:
    """Title, description, film, command, comparisons with published values or expectations, run time of a
    scene."""
    scene = _scene(name)
    lines = [f"## {scene['title']} {{ #{_identifier(name)} }}\n", f"{scene['description']}\n"]
    lines.append(_picture_or_film(name, scene["title"]))
    lines.append(f"```text\ngranflow example {name}\ngranflow run {Path(name).name}.yaml\n```\n")
    run = stored_results().get(name, {})
    if rows := list(_comparisons(name)):
        lines.append(table(("case", "granflow", "published or theory", "deviation"), rows))
    else:
        expected = expected_and_run(name, run.get("numbers", {}))
        found = [(code(quantity), unit, value, wanted) for quantity, unit, wanted, value in expected]
        lines.append(table(("quantity", "unit", "granflow", "expected"), found))
    if "wall_clock" in run:
        threads = f"{run['threads']} thread{'s' if run['threads'] > 1 else ''}"
        lines.append(
            f"Run time: {run['wall_clock']:.0f} s with {threads} ({run['processor']}, compilation included).\n"
        )
    return "\n".join(lines)


def _picture_or_film(name: str, title: str) -> str:
    """The film of a scene, with its picture before it plays; the picture alone or nothing if there is no
    file."""
    picture = picture_of(name)
    film = picture_of(name).with_suffix(".mp4")
    if film.exists():
        files = f'poster="gallery/{picture.name}" src="gallery/{film.name}"'
        return f'<video controls loop muted playsinline preload="none" width="480" title="{title}" {files}></video>\n'
    return f"![{title}](gallery/{picture.name}){{ width=360 }}\n" if picture.exists() else ""


def _comparisons(name: str) -> Iterator[tuple[str, ...]]:
    """Rows of the comparisons of a scene; a row "the same" belongs to the scene of the row before."""
    current = ""
    for row in YAML(typ="safe").load(COMPARISONS):
        if row["scene"].startswith("`"):
            current = row["scene"].split("`")[1]
        if current == name:
            case = row["scene"].replace(f"`{name}`", "").removeprefix("the same").lstrip(", ") or "as shipped"
            yield case, *(str(row.get(key, "")) for key in ("granflow", "published or theory", "deviation"))


def _scene(name: str) -> dict[str, Any]:
    """A scene as written."""
    scene: dict[str, Any] = YAML(typ="safe").load(SCENES / f"{name}.yaml")
    return scene


def _identifier(name: str) -> str:
    return name.replace("/", "-").replace("_", "-")
