"""Generated reference pages of the documentation: every key, command, quantity, public name and contact
model."""

import importlib
import re
from pathlib import Path
from typing import Annotated

import jsonschema
import pytest
from pydantic import BaseModel, TypeAdapter
from ruamel.yaml import YAML

import granflow
from granflow import fields
from granflow.cli.main import build_parser
from granflow.scene import reference as schema_keys
from granflow.scene.blocks.scene import SceneInput
from granflow.scene.reference import example_of, type_text

ROOT = Path(__file__).resolve().parents[2]


def docsite(name):
    return importlib.import_module(f"docsite.{name}")


@pytest.fixture(autouse=True)
def tools_on_path(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))


@pytest.fixture
def keys():
    return list(schema_keys.all_keys())


def test_every_scene_key_has_a_description_and_a_type_and_is_in_the_reference(keys):
    reference = docsite("scene_reference")
    assert len(keys) > 200
    for key in keys:
        assert key.description and type_text(key.schema), key
        page = reference.pages()[reference.page_of(key.part)]
        assert f'<span id="{reference.key_anchor(key)}"></span>`{key.name}`' in page


def test_undocumented_key_is_an_error():
    reference = docsite("scene_reference")
    key = schema_keys.Key("cone", "radius_from", {"type": "number"}, True)
    with pytest.raises(reference.UndocumentedError, match="radius_from has no description"):
        reference.row(schema_keys.Key("Cone", key.name, key.schema, True))


def test_links_of_the_scene_reference_have_targets():
    pages = docsite("scene_reference").pages()
    targets = {name: set(re.findall(r"\{ #([\w-]+) \}", page)) for name, page in pages.items()}
    found = 0
    for name, page in pages.items():
        folder = name.rpartition("/")[0]
        for target, part in re.findall(r"\]\(([\w/]*)(?:\.md)?#([\w-]+)\)", page):
            assert part in targets[f"{folder}/{target}".strip("/") if target else name], (name, target, part)
            found += 1
    assert found > 200


def test_examples_of_keys_are_valid(keys):
    definitions = {"$defs": schema_keys.parts()["scene"]["$defs"]}
    for key in keys:
        example = example_of(key)
        value = YAML(typ="safe").load(example)[key.name]
        jsonschema.Draft202012Validator(definitions | key.schema).validate(value)


def test_examples_of_keys_are_values_of_their_fields(keys):
    """Beyond the schema: the checks of each field, such as ranges in SI units, and names of quantities."""
    models = {model.__name__: model for model in _subclasses(BaseModel)} | {"scene": SceneInput}
    by_part = {}
    for key in keys:
        field = models[key.part].model_fields
        found = field.get(key.name) or next(each for each in field.values() if each.alias == key.name)
        value = YAML(typ="safe").load(example_of(key))[key.name]
        by_part.setdefault(key.part, {})[key.name] = TypeAdapter(
            Annotated[(found.annotation, *found.metadata)] if found.metadata else found.annotation
        ).validate_python(value)
        if key.name == "quantity":
            names = (*fields.TOTAL_QUANTITIES, *fields.FLOW_METER_QUANTITIES, *fields.WALL_FORCE_QUANTITIES)
            assert value.partition(".")[0] in names
    for sizes in ("UniformSizes", "NormalSizes", "LogNormalSizes"):
        assert by_part[sizes]["min"] < by_part[sizes].get("median", by_part[sizes].get("mean", 1.0))
        assert by_part[sizes]["min"] < by_part[sizes]["max"] <= 0.01
    assert by_part["MaterialPair"]["hamaker_constant"] < 1e-18
    assert by_part["MaterialPair"]["separation"] < 1e-9
    for name, value in by_part["TableMotion"].items():
        assert name not in ("displacements", "velocities", "angles") or len(value) == len(
            by_part["TableMotion"]["times"]
        )


def _subclasses(model):
    for each in model.__subclasses__():
        yield each
        yield from _subclasses(each)


def test_units_of_types_agree_with_descriptions(keys):
    """A unit in brackets in a description is the SI unit of the type."""
    found = 0
    for key in keys:
        described = re.search(r"\[((?:m|s|k|k?g|J|N|Pa|rad)[^\]]*)\]", key.description)
        typed = set(re.findall(r"number \[(.*?)\]", type_text(key.schema)))
        if described and typed:
            found += 1
            assert described[1] in typed, key
    assert found > 60


def test_every_quantity_is_in_the_reference():
    pages = docsite("quantity_pages")
    for name in fields.TOTAL_QUANTITIES:
        assert f"`{name}" in pages.time_series()
    meters = (*fields.FLOW_METER_QUANTITIES, *fields.RESIDENCE_QUANTITIES, *fields.OUTLET_QUANTITIES)
    for name in (*meters, *fields.WALL_FORCE_QUANTITIES):
        assert f"`{name}." in pages.time_series()
    displayed = [name for name, field in fields.PARTICLE_QUANTITIES.items() if field.displayed]
    for name in (*displayed, *fields.FIELD_QUANTITIES, "overlap", "traction"):
        assert f"| `{name}` |" in pages.vtu_arrays()
    for name in fields.RUN_QUANTITIES:
        assert f"`{name}" in pages.result()


def test_every_command_and_its_options_are_in_the_reference():
    page = docsite("command_page").page()
    for action in build_parser()._actions:
        for name, parser in (action.choices or {}).items():
            assert f"## granflow {name} {{ #{name} }}" in page
            options = [option for each in parser._actions for option in each.option_strings]
            assert all(option in page for option in options)


def test_public_names_their_members_and_keys_are_in_the_reference_of_python():
    overview = docsite("api_page").page() + docsite("api_page").blocks_page()
    classes = docsite("api_page").class_pages()
    for name in granflow.__all__:
        heading = f"](python/{name}.md)" if name in classes else f"\n### {name}\n"
        assert overview.count(heading) == 1
    for member in ("LiveParticles.velocity", "LiveWall.motion", "NormalLaw.force", "TangentialLaw.limit"):
        assert f"\n## {member}\n" in classes[member.partition(".")[0]]
    members = "overlap_rate [m/s], positive during approach"
    assert members in " ".join(overview.split()), "the members of the structs"
    scene = docsite("scene_reference").pages()
    links = [
        each for page in classes.values() for each in re.findall(r"\(\.\./(scene[\w/]*)\.md#([\w-]+)\)", page)
    ]
    assert len(links) > 150 and all(f'<span id="{link}"></span>' in scene[page] for page, link in links)


def test_every_contact_model_has_a_page_with_its_facts():
    models = docsite("model_pages")
    for name in models.names():
        text = (ROOT / "docs" / "pages" / "contact_models" / f"{name}.md").read_text(encoding="utf-8")
        assert text.count(f"<!-- contact model {name} -->") == 1
        slot, model = models.find(name)
        facts = models.facts(name)
        assert model.law.source in facts and model.law.limits in facts
        assert all(f"contact.{slot}.{key}" in facts for key in model.options.model_fields)
        assert all(f"pairs.NAME.{key}" in facts for key in model.pair_properties.model_fields)


@pytest.mark.parametrize(
    "name", ["zhou", "hertz", "linear", "walton_braun", "luding", "thornton", "eepa", "kuwabara_kono"]
)
def test_pictured_restitution_agrees_with_the_closed_form(name):
    """The integration with 400 steps is of second order: its error is far below the width of a line."""
    pictures = docsite("model_pictures")
    laws = docsite("example_laws")
    law = laws.normal_law(name)
    pair = laws.example_pair(name)
    radius, mass = laws.two_spheres()
    for velocity in (0.01, 1.0):
        restitution, duration = pictures.collide(law, pair, velocity)
        assert restitution == pytest.approx(law.restitution(pair, radius, mass, velocity), abs=5e-3)
        if name not in ("hertz", "linear", "eepa"):  # their closed forms are without damping
            assert duration == pytest.approx(sum(law.phase_durations(pair, radius, mass, velocity)), rel=0.01)


def test_preset_page_contains_the_sources():
    assert docsite("quantity_pages").presets().count("Source: ") == len(docsite("example_laws").PRESETS)


def test_gallery_contains_every_scene_and_every_comparison():
    gallery = docsite("gallery")
    page = gallery.page()
    rows = YAML(typ="safe").load(gallery.COMPARISONS)
    assert all(f"`{name}`" in page or f"granflow example {name}\n" in page for name in gallery.names())
    assert sum(page.count(" ".join(row["granflow"].split())) >= 1 for row in rows) == len(rows)
    pictures = set(re.findall(r"""[("]gallery/([\w.]+)[)"]""", page))
    assert pictures == {path.name for path in gallery.PICTURES.iterdir()}
    assert sum(path.stat().st_size for path in gallery.PICTURES.iterdir()) < 4e6, "the repository stays small"


def test_first_names_of_keys_commands_and_classes_are_links():
    """Not in headings, links and blocks of code, and not for words that have other meanings."""
    text = (
        "# `output.fields`\nSet `output.wall_forces: true`, [`pairs`](x.md) and `run`; `gf.Servo(...)` moves.\n"
        "```\n`stages`\n```\nAgain `output.wall_forces`, `walls.vtu`; `granflow check SCENE`, `stages`."
    )
    found = docsite("reference_links").linked(text, "guides/page.md")
    assert found == (
        "# `output.fields`\nSet [`output.wall_forces: true`](../reference/scene/output.md#output-wall-forces), "
        "[`pairs`](x.md) and `run`; [`gf.Servo(...)`](../reference/python/Servo.md) moves.\n```\n`stages`\n```\n"
        "Again `output.wall_forces`, `walls.vtu`; [`granflow check SCENE`](../reference/commands.md#check), "
        "[`stages`](../reference/scene/stages.md)."
    )
