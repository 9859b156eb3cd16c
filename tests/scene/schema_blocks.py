"""Hypothesis strategies for the blocks of a scene, generated from the JSON Schema of scene files."""

import random
import re
from functools import cache

from fuzzing import SCENES, copied, written
from hypothesis import strategies as st
from hypothesis_jsonschema import from_schema

from granflow.scene.reference import json_schema

NUMBER_PATTERN = r"^\s*[-+]?"
"""Beginning of the pattern of numbers with a unit."""

SCHEMA = json_schema()


def draft_7(schema):
    """The part of a schema in the dialect of hypothesis-jsonschema; references become constants {"$ref":
    name}.

    Strategies of nested definitions are slow; `filled` replaces the constants by values of the definitions.
    Numbers with a unit come from a list, because most numbers that match the pattern have a white space that
    is not ASCII.
    """
    if isinstance(schema, list):
        return [draft_7(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    if "$ref" in schema:
        return {"const": {"$ref": schema["$ref"].split("/")[-1]}}
    if str(schema.get("pattern", "")).startswith(NUMBER_PATTERN):
        units = re.search(r"\\s\*\((.*)\)\?", schema["pattern"])[1].replace("\\", "").split("|")
        return {"enum": [f"{number} {unit}" for number in ("0.02", "-3", "1e3") for unit in units[:3]]}
    found = {key: draft_7(each) for key, each in schema.items() if key not in ("description", "default")}
    return found | ({"items": found["prefixItems"]} if "prefixItems" in found else {})


@cache
def definition(name):
    """Strategy for one definition of the schema."""
    return from_schema(draft_7(SCHEMA["$defs"][name]))


def filled(draw, value):
    """The value with all references replaced by values of their definitions."""
    if isinstance(value, dict):
        if "$ref" in value:
            return filled(draw, draw(definition(value["$ref"])))
        return {key: filled(draw, each) for key, each in value.items()}
    return [filled(draw, each) for each in value] if isinstance(value, list) else value


@cache
def block(name):
    """Strategy for one block of a scene, with references as constants."""
    return from_schema(draft_7(SCHEMA["properties"][name]))


@st.composite
def scene_files(draw):
    """The bytes of a shipped scene in which generated blocks replace or supplement one to three of its
    blocks."""
    scene = copied(draw(st.sampled_from(SCENES)))
    for name in draw(
        st.lists(st.sampled_from(sorted(SCHEMA["properties"])), min_size=1, max_size=3, unique=True)
    ):
        value = filled(draw, draw(block(name)))
        is_supplement = isinstance(value, dict) and isinstance(scene.get(name), dict) and draw(st.booleans())
        scene[name] = scene[name] | value if is_supplement else value
    return written(scene, random.Random(0)).encode("utf-8", "surrogatepass")
