"""tools/validation/wrong_models.py: the errors apply to the source, and each contact model has one."""

import importlib
import json
from pathlib import Path

from validation import wrong_models

from granflow.contact.registry import models

STORED = Path(__file__).resolve().parents[3] / "docs" / "validation_results.json"


def test_wrong_models_apply_to_the_source_and_all_are_detected():
    """Each registered model is changed by 10 %, except for the base classes."""
    assert wrong_models.problems(wrong_models.WRONG_MODELS) == []
    for each in wrong_models.WRONG_MODELS:
        for family in each.families:
            module, name = family.split(":")
            assert callable(getattr(importlib.import_module(f"validation.{module}"), name))
    changed = " ".join(each.name for each in wrong_models.WRONG_MODELS if each.small)
    shared = {"capillary": "capillary bridges", "capillary_transfer": "capillary bridges"}
    for kind in ("normal", "tangential", "rolling", "twisting", "cohesion"):
        for name in models(kind):
            assert name == "none" or shared.get(name, name) in changed, name
    stored = json.loads(STORED.read_text(encoding="utf-8"))["wrong_models"]
    assert {each["name"] for each in stored} <= {each.name for each in wrong_models.WRONG_MODELS}
    assert [each["name"] for each in stored if not each["failing"]] == []
