"""Generated reference pages of the documentation: every key, command, quantity, public name and contact
model."""

import re
from pathlib import Path
from typing import Annotated

import pytest
from docsite import (
    api_page,
    command_page,
    example_laws,
    model_pages,
    model_pictures,
    quantity_pages,
    scene_reference,
)
from pydantic import BaseModel, TypeAdapter
from ruamel.yaml import YAML

import granflow
from granflow import fields
from granflow.cli.main import build_parser
from granflow.scene import reference as schema_keys
from granflow.scene.blocks.scene import SceneInput
from granflow.scene.reference import example_of, type_text

ROOT = Path(__file__).resolve().parents[2]
KEYS = list(schema_keys.all_keys())


def test_every_scene_key_is_in_the_reference_with_its_unit():
    """A unit in brackets in a description is the SI unit of the type."""
    assert len(KEYS) > 200
    pages = scene_reference.pages()
    for key in KEYS:
        page = pages[scene_reference.page_of(key.part)]
        assert f'<span id="{scene_reference.key_anchor(key)}"></span>`{key.name}`' in page
        described = re.search(r"\[((?:m|s|k|k?g|J|N|Pa|rad)[^\]]*)\]", key.description)
        typed = set(re.findall(r"number \[(.*?)\]", type_text(key.schema)))
        assert not described or not typed or described[1] in typed, key


def test_examples_of_keys_are_values_of_their_fields():
    """The checks of each field, such as ranges in SI units."""
    models = {model.__name__: model for model in _subclasses(BaseModel)} | {"scene": SceneInput}
    for key in KEYS:
        field = models[key.part].model_fields
        found = field.get(key.name) or next(each for each in field.values() if each.alias == key.name)
        kind = Annotated[(found.annotation, *found.metadata)] if found.metadata else found.annotation
        TypeAdapter(kind).validate_python(YAML(typ="safe").load(example_of(key))[key.name])


def _subclasses(model):
    for each in model.__subclasses__():
        yield each
        yield from _subclasses(each)


def test_every_quantity_command_and_public_name_is_in_the_reference():
    series = quantity_pages.time_series()
    meters = (*fields.FLOW_METER_QUANTITIES, *fields.RESIDENCE_QUANTITIES, *fields.OUTLET_QUANTITIES)
    for name in (*fields.TOTAL_QUANTITIES, *meters, *fields.WALL_FORCE_QUANTITIES):
        assert f"`{name}" in series
    displayed = [name for name, field in fields.PARTICLE_QUANTITIES.items() if field.displayed]
    for name in (*displayed, *fields.FIELD_QUANTITIES):
        assert f"| `{name}` |" in quantity_pages.vtu_arrays()
    assert all(f"`{name}" in quantity_pages.result() for name in fields.RUN_QUANTITIES)
    commands = command_page.page()
    for action in build_parser()._actions:
        for name, parser in (action.choices or {}).items():
            assert f"## granflow {name} {{ #{name} }}" in commands
            assert all(option in commands for each in parser._actions for option in each.option_strings)
    overview = api_page.page() + api_page.blocks_page()
    classes = api_page.class_pages()
    for name in granflow.__all__:
        heading = f"](python/{name}.md)" if name in classes else f"\n### {name}\n"
        assert overview.count(heading) == 1
    assert quantity_pages.presets().count("Source: ") == len(example_laws.PRESETS)


def test_every_contact_model_has_a_page_with_its_facts():
    for name in model_pages.names():
        text = (ROOT / "docs" / "pages" / "contact_models" / f"{name}.md").read_text(encoding="utf-8")
        assert text.count(f"<!-- contact model {name} -->") == 1
        slot, model = model_pages.find(name)
        facts = model_pages.facts(name)
        assert model.law.source in facts and model.law.limits in facts
        assert all(f"contact.{slot}.{key}" in facts for key in model.options.model_fields)
        assert all(f"pairs.NAME.{key}" in facts for key in model.pair_properties.model_fields)


@pytest.mark.parametrize("name", ["zhou", "walton_braun", "luding", "thornton", "eepa", "kuwabara_kono"])
def test_pictured_restitution_agrees_with_the_closed_form(name):
    """The integration with 400 steps is of second order: its error is far below the width of a line."""
    law = example_laws.normal_law(name)
    pair = example_laws.example_pair(name)
    for velocity in (0.01, 1.0):
        restitution, _ = model_pictures.collide(law, pair, velocity)
        expected = law.restitution(pair, *example_laws.two_spheres(), velocity)
        assert restitution == pytest.approx(expected, abs=5e-3)
