"""tools/validation/wrong_models.py: the errors apply to the source, and those of the review are detected."""

import importlib
import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def tool(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "tools" / "validation"))
    return importlib.import_module("wrong_models")


def test_wrong_models_apply_to_the_source_and_name_existing_families(tool):
    assert tool.problems(tool.WRONG_MODELS) == []
    assert len(tool.REVIEW) == 15
    assert len({each.name for each in tool.WRONG_MODELS}) == len(tool.WRONG_MODELS)
    for each in tool.WRONG_MODELS:
        for family in each.families:
            module, name = family.split(":")
            assert callable(getattr(importlib.import_module(f"granflow.studies.validation.{module}"), name))


def test_every_contact_model_has_a_wrong_one(tool):
    """A change of 10 % of each registered model, except for the base classes."""
    from granflow.contact.registry import models

    changed = " ".join(each.name for each in tool.WRONG_MODELS if each.small)
    shared = {"capillary": "capillary bridges", "capillary_transfer": "capillary bridges"}
    for kind in ("normal", "tangential", "rolling", "twisting", "cohesion"):
        for name in models(kind):
            assert name == "none" or shared.get(name, name) in changed, name


def test_stored_table_has_the_errors_of_the_review_and_all_are_detected(tool):
    stored = json.loads((ROOT / "docs" / "validation_results.json").read_text(encoding="utf-8"))[
        "wrong_models"
    ]
    assert [each["name"] for each in stored if not each["small"]] == [each.name for each in tool.REVIEW]
    assert {each["name"] for each in stored} <= {each.name for each in tool.WRONG_MODELS}
    assert [each["name"] for each in stored if not each["failing"]] == []
