"""Scenes gone wrong, as bytes of a file: shipped ones with values, keys and parts changed, and trees of anything."""

import random
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

ROOT = Path(__file__).parent.parent
FILES = sorted([*(ROOT / "scenes").rglob("*.yaml"), ROOT / "tests" / "messages" / "good.yaml"])
SCENES = [YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8")) for path in FILES]


class Raw(str):
    """Text that goes into the file as it stands."""


def paths_in(tree: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The paths of all values within a tree, the tree's own left out."""
    inside = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    found = []
    for key, value in inside:
        found += [(*path, key), *paths_in(value, (*path, key))]
    return found


ODD: list[Any] = [
    *(None, True, False, "", " ", "auto", "none", "on", [], {}, [[]], [0, 0, 0], [1e30] * 3, {"a": 1}, "é", "\u2028"),
    *(0, -1, 1, 2, 3.5, 1e-30, 1e30, -1e30, 1e-15, 1e15, 1e9, 2**31, 2**31 - 1, 2**63, 1e-4, 1e4, 10**500),
    *map(Raw, [".nan", ".inf", "-.inf", "1e308", "1e-308", "1e400", "9" * 400, "9" * 4000, "0x" + "f" * 300, "1_000"]),
    *map(
        Raw, ["012", "1:30", "2001-01-01", "yes", "~", "<<", "&a", "*a", "!!int 3", "!!python/object/apply:os.system"]
    ),
    *map(
        Raw, ["&a [*a]", "{<<: {a: 1}}", "? [a]", "{[a]: 1}", "|", ">", "'", '"', '"\\ud800"', "\t", "%", "@", "`", "["]
    ),
    *map(
        Raw, ["}", "- -", "a: b: c", "4 mm", "4 furlong", "1e30 m", "-3 GPa", "1e400 mm", "1 mm m", "nan mm", "inf s"]
    ),
    *("/etc/passwd", "../../etc/passwd", "/dev/zero", "$(ls)", "{{ x }}", "x" * 100_000, "\x07", "\x85", "\ufeff"),
    *(
        [[i] for i in range(3)],
        [None],
        {"preset": "stainless_316"},
        {"law": "zhou"},
        {"kind": "rain"},
        {"shape": "cone"},
    ),
]
"""Values that something may trip over."""

KEYS = sorted({path[-1] for scene in SCENES for path in paths_in(scene) if isinstance(path[-1], str)})

NOISE = [
    b"\0",
    b"\xff",
    b"\xfe\xff",
    b"\xef\xbb\xbf",
    b"\t",
    b"\r",
    b"\x1b[2J",
    b"\n\n",
    b"---\n",
    b"...\n",
    b"%TAG !\n",
]


def at(tree: Any, path: tuple[Any, ...]) -> Any:
    """What stands at a path."""
    for key in path:
        tree = tree[key]
    return tree


def copied(tree: Any) -> Any:
    """A copy that shares nothing that can change."""
    if isinstance(tree, dict):
        return {key: copied(value) for key, value in tree.items()}
    return [copied(value) for value in tree] if isinstance(tree, list) else tree


def mutated_file(dice: random.Random) -> bytes:
    """A file made from a shipped scene by one to four changes, mostly of its tree and sometimes of its bytes."""
    tree = copied(dice.choice(SCENES))
    for _ in range(dice.choice([1, 1, 1, 2, 2, 3, 4])):
        changed_once(tree, dice)
    raw = written(tree, dice).encode("utf-8", "surrogatepass")
    return noisy(raw, dice) if dice.random() < 0.15 else raw


def changed_once(tree: Any, dice: random.Random) -> None:
    """One change somewhere in the tree."""
    path = dice.choice(paths_in(tree))
    around, key, value = at(tree, path[:-1]), path[-1], at(tree, path)
    change = dice.choice([odd, odd, odd, scaled, scaled, foreign, foreign, lost, renamed, doubled, wrapped, swapped])
    change(around, key, value, dice)


def odd(around: Any, key: Any, value: Any, dice: random.Random) -> None:
    """Something else altogether."""
    around[key] = copied(dice.choice(ODD))


def scaled(around: Any, key: Any, value: Any, dice: random.Random) -> None:
    """A number of another size or sign; of a list, every one or the first."""
    factor = dice.choice([0, -1, 0.5, 2, 10.0 ** dice.uniform(-40, 40), 10.0 ** dice.uniform(-6, 6), 1 + 1e-15])
    around[key] = multiplied(value, factor)


def multiplied(value: Any, factor: float) -> Any:
    """Every number in a value times a factor; a number with a unit too."""
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


def foreign(around: Any, key: Any, value: Any, dice: random.Random) -> None:
    """What another scene, or another part of it, has under a key of the same name, or under any."""
    other = dice.choice(SCENES)
    paths = paths_in(other)
    alike = [path for path in paths if path[-1] == key]
    around[key] = copied(at(other, dice.choice(alike or paths)))


def lost(around: Any, key: Any, value: Any, dice: random.Random) -> None:
    """Nothing there any more."""
    del around[key]


def renamed(around: Any, key: Any, value: Any, dice: random.Random) -> None:
    """The key misspelt, or another one; the items of a list turned round."""
    if isinstance(around, list):
        around.reverse()
        return
    del around[key]
    names = [str(key)[:-1], str(key) * 2, "", str(key).upper(), dice.choice(paths_in(dice.choice(SCENES)))[-1], "é-é"]
    around[dice.choice(names)] = value


def doubled(around: Any, key: Any, value: Any, dice: random.Random) -> None:
    """An item, or a whole part under a second name, once more or a hundred times more."""
    for count in range(dice.choice([1, 1, 1, 100])):
        if isinstance(around, list):
            around.insert(key, copied(value))
        else:
            around[f"{key}{'abc'[count % 3]}{count or ''}"] = copied(value)


def wrapped(around: Any, key: Any, value: Any, dice: random.Random) -> None:
    """One level deeper, or thousands; or one level less."""
    inside = list(value.values()) if isinstance(value, dict) else value
    shapes = [[value], {"x": value}, str(value), Raw("[" * 3000), Raw("[" * 30 + "]" * 30)]
    around[key] = dice.choice([*shapes, inside[0]] if isinstance(inside, list) and inside else shapes)


def swapped(around: Any, key: Any, value: Any, dice: random.Random) -> None:
    """Two neighbors change places."""
    keys = list(around) if isinstance(around, dict) else range(len(around))
    other = dice.choice(list(keys))
    around[key], around[other] = around[other], around[key]


def written(tree: Any, dice: random.Random) -> str:
    """YAML of a tree, in blocks to a depth that varies, below that in one line."""
    return "\n".join(lines_of(tree, dice.choice([0, 1, 2, 3, 9]), "")) + "\n"


def lines_of(tree: Any, depth: int, indent: str) -> list[str]:
    """The lines of a tree: blocks down to `depth` levels."""
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
    """A tree in one line."""
    if isinstance(tree, dict):
        return "{" + ", ".join(f"{scalar(key)}: {flow(value)}" for key, value in tree.items()) + "}"
    return "[" + ", ".join(map(flow, tree)) + "]" if isinstance(tree, list) else scalar(tree)


def scalar(value: Any) -> str:
    """One value; plain where that is what it should read as."""
    if isinstance(value, Raw):
        return value
    if isinstance(value, str):
        plain = value and all(c.isalnum() or c in "_-./ " for c in value) and value[0].isalnum() and value[-1] != " "
        return value if plain else '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return str(value)


def noisy(raw: bytes, dice: random.Random) -> bytes:
    """Bytes put in, taken out, cut off, or the whole in another encoding."""
    place = dice.randrange(len(raw) + 1)
    return dice.choice(
        [
            raw[:place] + dice.choice(NOISE) + raw[place:],
            raw[:place] + raw[place + dice.randrange(20) :],
            raw[:place],
            raw + raw,
            raw.decode("utf-8", "replace").encode(dice.choice(["utf-16", "utf-16-le", "utf-32", "utf-8-sig"])),
            bytes(dice.randrange(256) for _ in range(200)),
            raw.replace(b"\n", dice.choice([b"\r\n", b"\r", b"\n\t", b"\n "])),
        ]
    )


def structure():
    """Trees of anything, with keys that scenes have at places where they may not."""
    keys = st.one_of(st.sampled_from(KEYS), st.text(max_size=5))
    values = st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8), st.sampled_from(ODD),
        st.builds("{} {}".format, st.floats(-1e3, 1e3), st.sampled_from(["mm", "GPa", "deg", "Hz", "m/s", "furlong"])),
    )  # fmt: skip
    return st.recursive(
        values, lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(keys, inner, max_size=6))
    )


def text_of(tree):
    return (written(tree, random.Random(0)) if isinstance(tree, dict | list) else str(tree)).encode("utf-8", "replace")


def made_by_hypothesis(count):
    """So many files: trees of anything, scenes with such a tree at one place, and plain text and bytes."""
    found = []
    grafted = st.builds(graft, st.sampled_from(SCENES), st.integers(0, 10**6), structure())
    files = st.one_of(structure().map(text_of), grafted.map(text_of), st.text().map(text_of), st.binary())

    @seed(6)
    @settings(
        max_examples=count, database=None, deadline=None, phases=[Phase.generate], suppress_health_check=HealthCheck
    )
    @given(files)
    def collect(raw):
        found.append(raw)

    collect()
    return found


def graft(scene, number, tree):
    """A scene with a tree in place of one of its values."""
    scene = copied(scene)
    paths = paths_in(scene)
    path = paths[number % len(paths)]
    at(scene, path[:-1])[path[-1]] = tree
    return scene
