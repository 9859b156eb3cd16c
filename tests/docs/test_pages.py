"""Hand-written pages: their scenes and commands work, and the site is built without a warning."""

import re
import shlex
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from granflow.cli.main import build_parser, main
from granflow.cli.run import scene_paths
from granflow.studies.calibration.calibrate import read_calibration
from granflow.studies.sweep import read_sweep

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs" / "pages"
TUTORIALS = sorted(path.stem for path in (PAGES / "tutorials").glob("*.md") if path.stem != "index")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
NAMED = re.compile(r"# ([\w.]+)(, continued)?\n")
"""First line of a block that is a file of the reader, or the continuation of one."""


def blocks(page):
    """Language and text of the code blocks of a page."""
    return BLOCK.findall((PAGES / page).read_text(encoding="utf-8"))


def save(text, folder):
    """Write a block that names its file; other blocks are fragments."""
    named = NAMED.match(text)
    if named:
        with (folder / named[1]).open("a" if named[2] else "w") as file:
            file.write(text[named.end() :])
    return bool(named)


def is_full_run_of_a_shipped_scene(command):
    """tests/scenes runs the shipped scenes."""
    return re.fullmatch(r"granflow run (\w+)\.yaml", command) and command.split()[-1][:-5] in scene_paths()


def run(command, folder):
    program, *rest = shlex.split(command)
    program = [sys.executable, "-m", "granflow"] if program == "granflow" else [sys.executable]
    return subprocess.run([*program, *rest], cwd=folder, capture_output=True, text=True, timeout=1200)


def test_no_text_advises_to_install_granflow_by_name():
    """There is no granflow on PyPI, and anyone can take the name: messages name the missing packages
    instead."""
    advice = re.compile(r"granflow\[|(?:pip|uv|uvx|pipx|conda)\W+(?:install|add) [\'\"\\]*granflow")
    for path in (ROOT / "README.md", *(ROOT / "docs").rglob("*"), *(ROOT / "granflow").rglob("*")):
        if path.suffix in (".md", ".ipynb", ".html", ".py", ".yaml"):
            assert not advice.findall(path.read_text(encoding="utf-8")), path


@pytest.mark.slow
@pytest.mark.parametrize("tutorial", TUTORIALS)
def test_tutorial_works_as_written(tutorial, tmp_path):
    executed = 0
    for language, text in blocks(f"tutorials/{tutorial}.md"):
        is_file = save(text, tmp_path)
        commands = text.replace("\\\n", "").splitlines() if language == "sh" else []
        if language == "python" and not is_file:
            (tmp_path / "snippet.py").write_text(text)
            commands = ["python snippet.py"]
        for command in commands:
            if not is_full_run_of_a_shipped_scene(command):
                done = run(command, tmp_path)
                assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
                executed += 1
    assert executed >= 2


def test_pages_use_existing_commands_and_are_in_the_navigation():
    configuration = (ROOT / "docs" / "mkdocs.yml").read_text(encoding="utf-8")
    for page in PAGES.rglob("*.md"):
        assert page.relative_to(PAGES).as_posix() in configuration
        texts = [text for language, text in blocks(page.relative_to(PAGES)) if language in ("sh", "text")]
        for command in "".join(texts).replace("\\\n", "").splitlines():
            if command.startswith("granflow "):
                try:
                    build_parser().parse_args(shlex.split(command, comments=True)[1:])
                except SystemExit as stop:
                    assert stop.code == 0, f"{page}: {command}"


@pytest.mark.slow
def test_python_guide_works_as_written(tmp_path):
    """The blocks of the page are one program."""
    program = "".join(text for language, text in blocks("guides/python.md") if language == "python")
    (tmp_path / "guide.py").write_text(program)
    done = run("python guide.py", tmp_path)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    assert "stopped at" in done.stdout and (tmp_path / "out" / "beads" / "result.json").exists()


STUDY_FILES = {"sweep.yaml": read_sweep, "restitution.yaml": read_sweep, "calibration.yaml": read_calibration}
"""Reader of each file in the guides that is not a scene; raises SceneError for an invalid file."""


def test_sweep_and_calibration_of_the_guide_are_valid(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("flat_silo.yaml", "angle_of_repose.yaml", "two_spheres.yaml"):
        shutil.copy(ROOT / "scenes" / name, tmp_path)
    Path("flow.csv").write_text("time,value\n0.0,0.0\n1.0,0.1\n")
    found = {
        NAMED.match(text)[1]: text for language, text in blocks(Path("guides/sweeps.md")) if NAMED.match(text)
    }
    assert set(found) == set(STUDY_FILES)
    for name, text in found.items():
        Path(name).write_text(text)
        STUDY_FILES[name](name)


def guide_scenes():
    """Names and texts of the complete scenes of the guides."""
    for path in sorted((PAGES / "guides").glob("*.md")):
        for language, text in blocks(path.relative_to(PAGES)):
            if language == "yaml" and NAMED.match(text) and NAMED.match(text)[1] not in STUDY_FILES:
                yield NAMED.match(text)[1], text


@pytest.mark.parametrize(("name", "text"), [pytest.param(*each, id=each[0]) for each in guide_scenes()])
def test_scene_of_a_guide_has_no_problems(name, text, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(text)
    assert main(["check", name]) == 0
    output = capsys.readouterr()
    assert output.out == f"{name}: no problems found.\n" and not output.err


@pytest.mark.slow
def test_site_is_built_and_a_dead_link_fails(tmp_path):
    pytest.importorskip("mkdocs")
    shutil.copytree(ROOT / "docs", tmp_path / "docs")
    (tmp_path / "tools").symlink_to(ROOT / "tools")
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "-f",
        str(tmp_path / "docs" / "mkdocs.yml"),
    ]
    build = partial(subprocess.run, command, cwd=ROOT, capture_output=True, text=True, timeout=1200)
    done = build()
    assert done.returncode == 0, done.stderr
    site = tmp_path / "out" / "site"
    walls = (site / "reference" / "scene" / "walls.html").read_text(encoding="utf-8")
    assert 'id="cone-radius-from"' in walls
    assert "<math" in (site / "contact_models" / "zhou.html").read_text(encoding="utf-8")
    loaded = r'<(?:script|link|img|iframe)\b[^>]*(?:src|href)="https?://'
    assert not re.search(loaded, (site / "index.html").read_text(encoding="utf-8"))
    with (tmp_path / "docs" / "pages" / "tutorials" / "hopper.md").open("a") as page:
        page.write("\n[dead](../guides/missing.md) and [dead](../guides/resume.md#missing)\n")
    done = build()
    assert done.returncode != 0 and "missing.md" in done.stderr and "#missing" in done.stderr
