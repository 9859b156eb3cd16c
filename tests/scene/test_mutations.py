"""Reading of changed scene files: the result is a Scene or a SceneError with positions, never another
exception."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from granflow.errors import SceneError
from granflow.load import Scene, load_scene

GOOD = Path(__file__).parent.parent / "messages" / "good.yaml"
TEXT = GOOD.read_text(encoding="utf-8")
LINES = TEXT.splitlines(keepends=True)
TOKENS = (
    TEXT.replace("{", " ").replace("}", " ").replace("[", " ").replace("]", " ").replace(",", " ").split()
)
ODD = [
    *(
        "", "~", "true", "-1", "0", "1e308", ".nan", "-.inf", "[]", "{}", "[1, 2, 3]", "{a: 1}", "'", '"',
        ":", "- ", "&a ", "*a"
    ),
    *(
        "\t", "!!int ", "4 Pa", "4 furlong", "1" * 400, "<x>", "[key]", "\x07", "\u2028", "é", "%", "? ",
        "|", "null: ", "<<: "
    )
]  # fmt: skip
QUICK = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def read(path, text, overrides=()):
    """Read the text as a scene; check the messages of an error, or the round trip of a valid scene."""
    path.write_text(text, encoding="utf-8", newline="")
    try:
        scene = load_scene(path, overrides)
    except SceneError as error:
        assert error.problems
        for problem in error.problems:
            assert problem.startswith((str(path), "--set"))
            assert problem.endswith((".", "?")) and "\n" not in problem
        return None
    assert isinstance(scene, Scene)
    again = path.with_name("again.yaml")
    again.write_text(scene.to_yaml(), encoding="utf-8")
    assert load_scene(again) == scene
    return scene


@QUICK
@given(st.data())
def test_replaced_token_gives_a_scene_or_messages(tmp_path, data):
    old = data.draw(st.sampled_from(TOKENS))
    new = data.draw(st.sampled_from(TOKENS + ODD))
    at = data.draw(st.sampled_from([i for i in range(len(TEXT)) if TEXT.startswith(old, i)]))
    read(tmp_path / "scene.yaml", TEXT[:at] + new + TEXT[at + len(old) :])


@QUICK
@given(st.data())
def test_deleted_repeated_and_moved_lines_give_a_scene_or_messages(tmp_path, data):
    lines = list(LINES)
    for _ in range(data.draw(st.integers(1, 3))):
        line = lines.pop(data.draw(st.integers(0, len(lines) - 1)))
        for _ in range(data.draw(st.integers(0, 2))):
            lines.insert(data.draw(st.integers(0, len(lines))), line)
    read(tmp_path / "scene.yaml", "".join(lines))


@QUICK
@given(at=st.integers(0, len(TEXT)), text=st.text(max_size=5), deleted=st.integers(0, 20))
def test_replaced_characters_give_a_scene_or_messages(tmp_path, at, text, deleted):
    text = text.encode("utf-8", "ignore").decode()
    read(tmp_path / "scene.yaml", TEXT[:at] + text + TEXT[at + deleted :])


KEYS = [
    "walls", "tube", "radius", "stages", "0", "name", "gravity", "2", "particles", "grit", "diameter",
    "classes", "x", ""
]  # fmt: skip


@QUICK
@given(keys=st.lists(st.sampled_from(KEYS), max_size=5), value=st.sampled_from(TOKENS + ODD))
def test_random_overrides_give_a_scene_or_messages(tmp_path, keys, value):
    read(tmp_path / "scene.yaml", TEXT, [f"{'.'.join(keys)}={value}"])


@pytest.mark.parametrize(
    "raw", [b"\x00", b"\xff", b"\xfe\xff", b"a: \xc3", b"%YAML 9.9\n---\na: 1", b"\x1b[0m"]
)
def test_invalid_bytes_raise_scene_error(raw, tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_bytes(raw)
    with pytest.raises(SceneError):
        load_scene(path)
