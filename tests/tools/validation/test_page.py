"""tools/validation: statuses, exit code, the page against its stored data, and wrong models."""

import importlib
import json
from pathlib import Path

import pytest
from validation import run, wrong_models
from validation.case import ValidationCase

from granflow.contact.registry import models

DOCS = Path(__file__).resolve().parents[3] / "docs"


def case(value, **more):
    """A case with the reference 2 and an allowed deviation of 1 %."""
    return ValidationCase("kind", "name", 2.0, "source", value, "m", 0.01, "reason", **more)


@pytest.mark.parametrize(("value", "more", "status"), [
    (2.019, {}, "pass"), (1.981, {}, "pass"), (2.021, {}, "fail"), (1.979, {}, "fail"), (float("nan"), {}, "fail"),
    (2.05, {"scale": 10.0}, "pass"), (3.0, {"in_range": False}, "miss"), (float("nan"), {"in_range": False}, "fail")
])  # fmt: skip
def test_status_depends_on_the_allowed_deviation_and_gives_the_exit_code(
    tmp_path, monkeypatch, value, more, status
):
    """The scale replaces the reference. One family is run in place of minutes of runs."""
    monkeypatch.setattr(run, "FAMILIES", {"one": lambda: [case(value, **more)]})
    monkeypatch.setattr(run, "CASES", {})
    assert run.main(["--out", str(tmp_path)]) == int(status == "fail")
    stored = json.loads((tmp_path / "validation_results.json").read_text())
    assert [each["status"] for each in stored["families"]["one"]["cases"]] == [status]
    assert f"| {status} |" in (tmp_path / "validation.md").read_text()


def test_page_of_the_documentation_equals_its_stored_data():
    stored = json.loads((DOCS / "validation_results.json").read_text(encoding="utf-8"))
    assert (DOCS / "pages" / "validation.md").read_text(encoding="utf-8") == run.rendered(stored)
    families = stored["families"].values()
    cases = [ValidationCase.from_dict(each) for family in families for each in family["cases"]]
    assert set(stored["families"]) == set(run.all_families())
    assert len(cases) > 100 and not stored["quick"]
    assert [each.name for each in cases if each.status == "fail"] == []


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
