"""`granflow check` of arbitrary files: a valid scene or messages with positions."""

import json
import random
import re
from copy import deepcopy
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from granflow.cli.main import main
from granflow.cli.run import scene_paths
from granflow.errors import SceneError
from granflow.load import load_scene
from granflow.plan import cost as memory_check

GOOD = Path(__file__).parents[1] / "messages" / "good.yaml"
SCENES = [
    YAML(typ="safe", pure=True).load(path.read_text("utf-8")) for path in [*scene_paths().values(), GOOD]
]
ODD = [
    None, True, "", " ", "auto", "none", [], {}, [[]], [0, 0, 0], [1e30] * 3, {"a": 1}, "é", "\u2028", "\x07", "${x}",
    0, -1, 2, 3.5, 1e-30, 1e30, -1e30, 1e-15, 1e9, 2**31, 2**63, 10**500, "4 mm", "4 furlong", "-3 GPa", "1e400 mm",
    "nan mm", "x" * 100_000, "/dev/zero", [None], {"preset": "stainless_316"}, {"law": "zhou"}, {"kind": "rain"},
]  # fmt: skip
"""Values that a reader or a check may handle incorrectly."""


def paths_in(tree, path=()):
    """The paths of all values within a tree, without the empty path of the root."""
    children = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    found = []
    for key, value in children:
        found += [(*path, key), *paths_in(value, (*path, key))]
    return found


def at(tree, path):
    """The value at a path."""
    for key in path:
        tree = tree[key]
    return tree


def change(tree, rng):
    """Apply one random change at a random path: of the value, its magnitude, its key or the number of its
    copies."""
    *above, key = rng.choice(paths_in(tree))
    parent = at(tree, above)
    value = parent[key]
    other = rng.choice(SCENES)
    kind = rng.choice(
        ["odd", "odd", "scaled", "scaled", "other", "other", "deleted", "renamed", "doubled", "nested"]
    )
    if kind == "scaled" and isinstance(value, int | float) and not isinstance(value, bool):
        parent[key] = value * rng.choice(
            [0, -1, 0.5, 2, 10.0 ** rng.uniform(-40, 40), 10.0 ** rng.uniform(-6, 6)]
        )
    elif kind == "other":
        same = [path for path in paths_in(other) if path[-1] == key]
        parent[key] = deepcopy(at(other, rng.choice(same or paths_in(other))))
    elif kind == "deleted":
        del parent[key]
    elif kind in ("renamed", "doubled") and isinstance(parent, dict):
        parent[rng.choice([f"{key}"[:-1], f"{key}" * 2, "", "é-é"])] = deepcopy(value)
        if kind == "renamed":
            del parent[key]
    elif kind == "doubled":
        parent.insert(key, deepcopy(value))
    else:
        parent[key] = [value] if kind == "nested" else deepcopy(rng.choice(ODD))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("number", range(30))
def test_changed_scene_is_accepted_or_rejected_with_positions(number, tmp_path, monkeypatch, capsys):
    """Little available memory excludes large packings, which take a long time to generate."""
    monkeypatch.setattr(memory_check, "available_memory", lambda: 120_000_000)
    rng = random.Random(number)
    tree = deepcopy(rng.choice(SCENES))
    for _ in range(rng.choice([1, 1, 2, 3])):
        change(tree, rng)
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(tree, indent=1), encoding="utf-8")
    code = main(["check", str(path)])
    lines = capsys.readouterr().err.splitlines()
    lines = [line for line in lines if not line.startswith("granflow: warning: ")]
    if code == 0:
        scene = load_scene(path)
        (tmp_path / "again.yaml").write_text(scene.to_yaml(), encoding="utf-8")
        assert not lines and load_scene(tmp_path / "again.yaml") == scene
    else:
        assert code == 2 and re.fullmatch(r"\d+ problems? found\.", lines.pop())
        assert all(re.fullmatch(r".*scene\.yaml(:\d+:\d+)?: \S.*[.?]", line) for line in lines), lines
        assert not any("nan" in line for line in lines) or "nan" in path.read_text("utf-8").lower()


OVERRIDE_KEYS = "walls tube radius stages 0 name gravity 2 particles grit diameter classes x".split() + [""]
OVERRIDE_VALUES = [
    "", "~", "true", "-1", "0", "1e308", ".nan", "-.inf", "[]", "{}", "[1, 2, 3]", "{a: 1}", "'", '"', ":", "- ", "&a ",
    "*a", "\t", "!!int ", "4 Pa", "4 furlong", "1" * 400, "<x>", "[key]", "\x07", "\u2028", "é", "%", "? ", "|",
]  # fmt: skip


def test_random_overrides_give_a_scene_or_messages():
    rng = random.Random(3)
    refused = 0
    for _ in range(50):
        keys = rng.choices(OVERRIDE_KEYS, k=rng.randrange(6))
        try:
            load_scene(GOOD, [f"{'.'.join(keys)}={rng.choice(OVERRIDE_VALUES)}"])
        except SceneError as error:
            refused += 1
            assert error.problems
            for problem in error.problems:
                assert problem.startswith((str(GOOD), "--set")) and problem.endswith((".", "?"))
                assert "\n" not in problem
    assert refused > 25


@pytest.mark.parametrize(("text", "sentences"), [
    ("materials:\n" + "".join(f"  m{n}: {{}}\n" for n in range(51)),
     [":1:1: materials has 51 entries, but the limit is 50."]),
    ("title: x\n" + "".join(f"k{n}: 1\n" for n in range(200)),
     [":93:1: k91 is not a known key.", ":201:1: this is the last of 108 more problems, which are not shown."]),
], ids=["entries", "problems"])  # fmt: skip
def test_messages_state_the_exceeded_limit(tmp_path, text, sentences):
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    problems = caught.value.problems
    assert len(problems) <= 101
    for sentence in sentences:
        assert any(problem.startswith(f"{path}{sentence}") for problem in problems), problems[-3:]
