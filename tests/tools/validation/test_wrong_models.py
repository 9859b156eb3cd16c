"""tools/validation/wrong_models.py: the errors apply to the source, and those of the review are detected."""

import importlib
import json
from pathlib import Path

from validation import wrong_models

ROOT = Path(__file__).resolve().parents[3]


def test_wrong_models_apply_to_the_source_and_name_existing_families():
    assert wrong_models.problems(wrong_models.WRONG_MODELS) == []
    assert len(wrong_models.REVIEW) == 15
    assert len({each.name for each in wrong_models.WRONG_MODELS}) == len(wrong_models.WRONG_MODELS)
    for each in wrong_models.WRONG_MODELS:
        for family in each.families:
            module, name = family.split(":")
            assert callable(getattr(importlib.import_module(f"validation.{module}"), name))


def test_every_contact_model_has_a_wrong_one():
    """A change of 10 % of each registered model, except for the base classes."""
    from granflow.contact.registry import models

    changed = " ".join(each.name for each in wrong_models.WRONG_MODELS if each.small)
    shared = {"capillary": "capillary bridges", "capillary_transfer": "capillary bridges"}
    for kind in ("normal", "tangential", "rolling", "twisting", "cohesion"):
        for name in models(kind):
            assert name == "none" or shared.get(name, name) in changed, name


def test_stored_table_has_the_errors_of_the_review_and_all_are_detected():
    stored = json.loads((ROOT / "docs" / "validation_results.json").read_text(encoding="utf-8"))[
        "wrong_models"
    ]
    assert [each["name"] for each in stored if not each["small"]] == [
        each.name for each in wrong_models.REVIEW
    ]
    assert {each["name"] for each in stored} <= {each.name for each in wrong_models.WRONG_MODELS}
    assert [each["name"] for each in stored if not each["failing"]] == []
