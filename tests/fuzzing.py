"""Fuzzed scene files as bytes: shipped scenes with random changes of values, keys and parts, and random
trees."""

import random
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from granflow.cli.run import scene_paths

ROOT = Path(__file__).parent.parent
FILES = sorted([*scene_paths().values(), ROOT / "tests" / "messages" / "good.yaml"])
SCENES = [YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8")) for path in FILES]


class Raw(str):
    """Text that is written to the file unchanged, without quotes."""


def paths_in(tree: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The paths of all values within a tree, without the empty path of the root."""
    children = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    found = []
    for key, value in children:
        found += [(*path, key), *paths_in(value, (*path, key))]
    return found


RAW = """.nan .inf -.inf 1e308 1e-308 1e400 1_000 012 1:30 2001-01-01 yes ~ << &a *a | > ' "
"\\ud800" % @ ` [ } !!python/object/apply:os.system""".split()
ODD: list[Any] = [
    None, True, False, "", " ", "auto", "none", "on", [], {}, [[]], [0, 0, 0], [1e30] * 3, {"a": 1}, "é", "\u2028",
    0, -1, 1, 2, 3.5, 1e-30, 1e30, -1e30, 1e-15, 1e15, 1e9, 2**31, 2**31 - 1, 2**63, 1e-4, 1e4, 10**500,
    *map(Raw, RAW), *map(Raw, ["9" * 400, "9" * 4000, "0x" + "f" * 300, "!!int 3", "&a [*a]", "{<<: {a: 1}}"]),
    *map(Raw, ["? [a]", "{[a]: 1}", "\t", "- -", "a: b: c", "4 mm", "4 furlong", "1e30 m", "-3 GPa", "1e400 mm"]),
    *map(Raw, ["1 mm m", "nan mm", "inf s"]),
    "/etc/passwd", "../../etc/passwd", "/dev/zero", "$(ls)", "{{ x }}", "x" * 100_000, "\x07", "\x85", "\ufeff",
    *([i] for i in range(3)), [None], {"preset": "stainless_316"}, {"law": "zhou"}, {"kind": "rain"}, {"shape": "cone"},
]  # fmt: skip
"""Values that a reader or a check may handle incorrectly."""

KEYS = sorted({path[-1] for scene in SCENES for path in paths_in(scene) if isinstance(path[-1], str)})

NOISE = [
    b"\0", b"\xff", b"\xfe\xff", b"\xef\xbb\xbf", b"\t", b"\r", b"\x1b[2J", b"\n\n", b"---\n", b"...\n",
    b"%TAG !\n"
]  # fmt: skip


def at(tree: Any, path: tuple[Any, ...]) -> Any:
    """The value at a path."""
    for key in path:
        tree = tree[key]
    return tree


def copied(tree: Any) -> Any:
    """A deep copy of mappings and lists."""
    if isinstance(tree, dict):
        return {key: copied(value) for key, value in tree.items()}
    return [copied(value) for value in tree] if isinstance(tree, list) else tree


def mutated_file(rng: random.Random) -> bytes:
    """A shipped scene with one to four random changes of its tree, and in 15 % of the files one change of its
    bytes."""
    tree = copied(rng.choice(SCENES))
    for _ in range(rng.choice([1, 1, 1, 2, 2, 3, 4])):
        changed_once(tree, rng)
    raw = written(tree, rng).encode("utf-8", "surrogatepass")
    return noisy(raw, rng) if rng.random() < 0.15 else raw


def changed_once(tree: Any, rng: random.Random) -> None:
    """Apply one random change at a random path of the tree."""
    path = rng.choice(paths_in(tree))
    parent = at(tree, path[:-1])
    key = path[-1]
    value = at(tree, path)
    change = rng.choice([
        replaced_by_odd_value, replaced_by_odd_value, replaced_by_odd_value, scaled, scaled,
        replaced_from_scene, replaced_from_scene, deleted, renamed, doubled, wrapped, swapped
    ])  # fmt: skip
    change(parent, key, value, rng)


def replaced_by_odd_value(parent: Any, key: Any, value: Any, rng: random.Random) -> None:
    """Replace the value by one of `ODD`."""
    parent[key] = copied(rng.choice(ODD))


def scaled(parent: Any, key: Any, value: Any, rng: random.Random) -> None:
    """Multiply the numbers of the value by a random factor, which changes their magnitude or sign."""
    factor = rng.choice([0, -1, 0.5, 2, 10.0 ** rng.uniform(-40, 40), 10.0 ** rng.uniform(-6, 6), 1 + 1e-15])
    parent[key] = multiplied(value, factor)


def multiplied(value: Any, factor: float) -> Any:
    """The value with every number multiplied by a factor, including numbers with a unit."""
    if isinstance(value, list):
        return [multiplied(each, factor) for each in value]
    if isinstance(value, dict):
        return {key: multiplied(each, factor) for key, each in value.items()}
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return value
    number, blank, unit = value.partition(" ") if isinstance(value, str) else (value, "", "")
    try:
        return f"{float(number) * factor!r} {unit}" if blank else type(value)(value * factor)
    except (ValueError, OverflowError, TypeError):
        return value


def replaced_from_scene(parent: Any, key: Any, value: Any, rng: random.Random) -> None:
    """Replace the value by a value of another scene, under a key of the same name if that scene has one."""
    other = rng.choice(SCENES)
    paths = paths_in(other)
    same_key = [path for path in paths if path[-1] == key]
    parent[key] = copied(at(other, rng.choice(same_key or paths)))


def deleted(parent: Any, key: Any, value: Any, rng: random.Random) -> None:
    """Delete the key or the list item."""
    del parent[key]


def renamed(parent: Any, key: Any, value: Any, rng: random.Random) -> None:
    """Misspell or replace the key of a mapping; reverse a list."""
    if isinstance(parent, list):
        parent.reverse()
        return
    del parent[key]
    names = [
        str(key)[:-1], str(key) * 2, "", str(key).upper(), rng.choice(paths_in(rng.choice(SCENES)))[-1],
        "é-é"
    ]  # fmt: skip
    parent[rng.choice(names)] = value


def doubled(parent: Any, key: Any, value: Any, rng: random.Random) -> None:
    """Repeat a list item, or a part of a mapping under a new name, once or a hundred times."""
    for count in range(rng.choice([1, 1, 1, 100])):
        if isinstance(parent, list):
            parent.insert(key, copied(value))
        else:
            parent[f"{key}{'abc'[count % 3]}{count or ''}"] = copied(value)


def wrapped(parent: Any, key: Any, value: Any, rng: random.Random) -> None:
    """Nest the value one level deeper or thousands of levels deep, or replace it by its first child."""
    children = list(value.values()) if isinstance(value, dict) else value
    shapes = [[value], {"x": value}, str(value), Raw("[" * 3000), Raw("[" * 30 + "]" * 30)]
    parent[key] = rng.choice([*shapes, children[0]] if isinstance(children, list) and children else shapes)


def swapped(parent: Any, key: Any, value: Any, rng: random.Random) -> None:
    """Exchange the value with another value of the same mapping or list."""
    keys = list(parent) if isinstance(parent, dict) else range(len(parent))
    other = rng.choice(list(keys))
    parent[key], parent[other] = parent[other], parent[key]


def written(tree: Any, rng: random.Random) -> str:
    """YAML of a tree: block style down to a random depth, flow style below it."""
    return "\n".join(lines_of(tree, rng.choice([0, 1, 2, 3, 9]), "")) + "\n"


def lines_of(tree: Any, depth: int, indent: str) -> list[str]:
    """The lines of a tree in block style down to `depth` levels."""
    if not depth or not tree or not isinstance(tree, dict | list):
        return [indent + flow(tree)]
    found = []
    entries = tree.items() if isinstance(tree, dict) else ((None, each) for each in tree)
    for key, value in entries:
        head = f"{indent}- " if key is None else f"{indent}{scalar(key)}: "
        inner = lines_of(value, depth - 1, indent + "  ")
        found += [head + inner[0].lstrip()] if len(inner) == 1 else [head.rstrip(), *inner]
    return found


def flow(tree: Any) -> str:
    """A tree in YAML flow style, on one line."""
    if isinstance(tree, dict):
        return "{" + ", ".join(f"{scalar(key)}: {flow(value)}" for key, value in tree.items()) + "}"
    return "[" + ", ".join(map(flow, tree)) + "]" if isinstance(tree, list) else scalar(tree)


def scalar(value: Any) -> str:
    """One scalar: unquoted if the text contains no special character, otherwise in double quotes."""
    if isinstance(value, Raw):
        return value
    if isinstance(value, str):
        plain = (
            value
            and all(c.isalnum() or c in "_-./ " for c in value)
            and value[0].isalnum()
            and value[-1] != " "
        )
        return value if plain else '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return str(value)


def noisy(raw: bytes, rng: random.Random) -> bytes:
    """The bytes with an insertion, a deletion, a truncation, other line endings or another encoding."""
    offset = rng.randrange(len(raw) + 1)
    return rng.choice([
        raw[:offset] + rng.choice(NOISE) + raw[offset:], raw[:offset] + raw[offset + rng.randrange(20) :],
        raw[:offset], raw + raw,
        raw.decode("utf-8", "replace").encode(rng.choice(["utf-16", "utf-16-le", "utf-32", "utf-8-sig"])),
        bytes(rng.randrange(256) for _ in range(200)),
        raw.replace(b"\n", rng.choice([b"\r\n", b"\r", b"\n\t", b"\n "]))
    ])  # fmt: skip


def structure():
    """Strategy for random trees; keys are random text or keys of scenes at any level."""
    keys = st.one_of(st.sampled_from(KEYS), st.text(max_size=5))
    values = st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8), st.sampled_from(ODD),
        st.builds("{} {}".format, st.floats(-1e3, 1e3), st.sampled_from(["mm", "GPa", "deg", "Hz", "m/s", "furlong"])),
    )  # fmt: skip
    return st.recursive(
        values, lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(keys, inner, max_size=6))
    )


def text_of(tree):
    """The bytes of a file with this tree."""
    return (written(tree, random.Random(0)) if isinstance(tree, dict | list) else str(tree)).encode(
        "utf-8", "replace"
    )


def hypothesis_files(count):
    """`count` files: random trees, scenes with a random tree in place of one value, random text and random
    bytes."""
    grafted = st.builds(graft, st.sampled_from(SCENES), st.integers(0, 10**6), structure())
    return drawn(
        st.one_of(structure().map(text_of), grafted.map(text_of), st.text().map(text_of), st.binary()), count
    )


def drawn(files, count):
    """`count` files from a strategy, the same ones in every run."""
    found = []

    @seed(6)
    @settings(
        max_examples=count, database=None, deadline=None, phases=[Phase.generate],
        suppress_health_check=HealthCheck
    )  # fmt: skip
    @given(files)
    def collect(raw):
        found.append(raw)

    collect()
    return found


def graft(scene, number, tree):
    """A scene in which a tree replaces one value."""
    scene = copied(scene)
    paths = paths_in(scene)
    path = paths[number % len(paths)]
    at(scene, path[:-1])[path[-1]] = tree
    return scene
