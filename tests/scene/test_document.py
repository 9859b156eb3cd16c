"""YAML 1.2 reader: types of plain scalars, positions of keys and values, rejected documents."""

import math

import pytest

from granflow.schema.document import DocumentError, parse


@pytest.mark.parametrize(("text", "value"), [
    ("012", 12), ("0o14", 12), ("0x1F", 31), ("1e-5", 1e-5), ("1E5", 1e5), (".5", 0.5), ("-4.", -4.0),
    ("+3", 3), ("true", True), ("False", False), ("yes", "yes"), ("no", "no"), ("on", "on"), ("null", None),
    ("~", None), ("none", "none"), ("1:30", "1:30"), ("1_000", "1_000"), ("2020-01-01", "2020-01-01"),
    ("'1e-5'", "1e-5"), (".inf", math.inf), ("-.INF", -math.inf), ("4 mm", "4 mm"), ("1" * 500, math.inf)
], ids=lambda value: str(value)[:20])  # fmt: skip
def test_scalars_have_their_yaml_1_2_type(text, value):
    data = parse(f"key: {text}", "file").root.data()["key"]
    assert data == value and type(data) is type(value)


def test_keys_values_and_duplicates_have_positions_and_aliases_are_resolved():
    document = parse("a:\n  - b: &x 1\n    c: [2, {d: *x}]\na: 3\nc: .nan\nc: 4\n", "file")
    data = document.root.data()
    assert data["a"] == [{"b": 1, "c": [2, {"d": 1}]}] and math.isnan(data["c"])
    assert str(document.key_position(("a",))) == "file:1:1"
    assert str(document.key_position(("a", 0, "c"))) == "file:3:5"
    assert document.where(("a", 0, "c", 1, "x", "y")) == "file:3"
    assert [str(problem.position) for problem in document.problems] == ["file:4:1", "file:6:1"]


@pytest.mark.parametrize(
    "text", ["&a [*a]", "&a {b: *a}", "*a", "!!python/object:os {}", "a: 1\n---\nb: 2", "? [a]\n: b"]
)
def test_unsupported_yaml_is_rejected(text):
    with pytest.raises(DocumentError):
        parse(text, "file")
