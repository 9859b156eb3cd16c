"""YAML 1.2 reader: types of plain scalars, positions of keys and values, rejected documents."""

import math

import pytest

from granflow.schema.document import DocumentError, parse

SCALARS = [
    ("012", 12), ("0o14", 12), ("0x1F", 31), ("1e-5", 1e-5), ("1E5", 1e5), (".5", 0.5), ("-4.", -4.0),
    ("+3", 3), ("true", True), ("False", False), ("yes", "yes"), ("no", "no"), ("on", "on"), ("null", None),
    ("~", None), ("none", "none"), ("1:30", "1:30"), ("1_000", "1_000"), ("2020-01-01", "2020-01-01"),
    ("'1e-5'", "1e-5"), (".inf", math.inf), ("-.INF", -math.inf), ("4 mm", "4 mm"), ("1" * 500, math.inf)
]  # fmt: skip


@pytest.mark.parametrize(("text", "value"), SCALARS, ids=lambda value: str(value)[:20])
def test_scalars_have_their_yaml_1_2_type(text, value):
    data = parse(f"key: {text}", "file").root.data()["key"]
    assert data == value and type(data) is type(value)


def test_nan_is_read_as_nan():
    assert math.isnan(parse(".nan", "file").root.data())


def test_positions_of_keys_and_values():
    document = parse("a:\n  - b: 1\n    c: [2, {d: 3}]\n", "file")
    assert str(document.key_position(("a",))) == "file:1:1"
    assert str(document.key_position(("a", 0, "c"))) == "file:3:5"
    assert str(document.value_position(("a", 0, "c", 1, "d"))) == "file:3:16"
    assert document.where(("a", 0, "c", 1, "x", "y")) == "file:3"


def test_aliases_are_resolved():
    assert parse("a: &x {b: 1}\nc: *x\n", "file").root.data() == {"a": {"b": 1}, "c": {"b": 1}}


@pytest.mark.parametrize(
    "text", ["&a [*a]", "&a {b: *a}", "*a", "!!python/object:os {}", "a: 1\n---\nb: 2", "? [a]\n: b"]
)
def test_unsupported_yaml_is_rejected(text):
    with pytest.raises(DocumentError):
        parse(text, "file")


def test_all_duplicate_keys_are_reported():
    document = parse("a: 1\na: 2\nb: 3\nb: 4\n", "file")
    assert document.root.data() == {"a": 1, "b": 3}
    assert [str(problem.position) for problem in document.problems] == ["file:2:1", "file:4:1"]
