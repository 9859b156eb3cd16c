"""tools/validation/run.py: statuses, exit code, and the page of the documentation against its stored data."""

import json
from pathlib import Path

import pytest
from validation import run
from validation.case import ValidationCase

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
