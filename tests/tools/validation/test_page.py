"""tools/validation/run.py: statuses, exit code, and the page of the documentation against its stored data."""

import json
from pathlib import Path

import pytest
from validation import run
from validation.case import ValidationCase

DOCS = Path(__file__).resolve().parents[3] / "docs"
STORED = DOCS / "validation_results.json"


def case(value, **more):
    """A case with the reference 2 and an allowed deviation of 1 %."""
    return ValidationCase("kind", "name", 2.0, "source", value, "m", 0.01, "reason", **more)


@pytest.mark.parametrize(("value", "status"), [
    (2.0, "pass"), (2.019, "pass"), (1.981, "pass"), (2.021, "fail"), (1.979, "fail"),
    (float("nan"), "fail")
])  # fmt: skip
def test_status_depends_on_the_allowed_deviation(value, status):
    assert case(value).status == status


def test_scale_replaces_the_reference():
    assert case(2.05, scale=10.0).deviation == pytest.approx(0.005)
    assert case(2.05, scale=10.0).status == "pass"


@pytest.fixture
def families(monkeypatch):
    """The families of all cases, initially none: a test sets its own cases in place of minutes of
    runs."""
    chosen = {}
    monkeypatch.setattr(run, "FAMILIES", chosen)
    monkeypatch.setattr(run, "CASES", {})
    return chosen


@pytest.mark.parametrize(("value", "exit_code"), [(2.0, 0), (3.0, 1)])
def test_wrong_number_fails_with_exit_code_1(tmp_path, families, capsys, value, exit_code):
    families["one"] = lambda: [case(value)]
    assert run.main(["--out", str(tmp_path)]) == exit_code
    assert ("fail: kind, name: 3 instead of 2 m" in capsys.readouterr().out) == bool(exit_code)
    status = "fail" if exit_code else "pass"
    stored = json.loads((tmp_path / "validation_results.json").read_text())
    assert [each["status"] for each in stored["families"]["one"]["cases"]] == [status]
    page = (tmp_path / "validation.md").read_text()
    assert f"| {status} |" in page and "### Wrong models" in page


def test_quick_runs_its_own_cases(tmp_path, monkeypatch, families):
    families["long"] = lambda: [case(3.0)]
    monkeypatch.setattr(run, "QUICK", {"short": lambda: [case(2.0)]})
    assert run.main(["--quick", "--out", str(tmp_path)]) == 0
    page = (tmp_path / "validation.md").read_text()
    assert "--quick" in page and "### Wrong models" not in page


def test_only_replaces_the_rows_of_its_families(tmp_path, monkeypatch, families):
    """The rows of the other families keep their numbers and dates, in the order of the families."""
    families["new"] = lambda: [case(2.0, scale=1.0)]
    families["old"] = families["other"] = lambda: 1 / 0
    before = {
        name: {"version": "0.0", "date": "2000-01-01", "cases": [case(value).as_dict()]}
        for name, value in (("old", 2.01), ("new", 3.0))
    }
    data = tmp_path / "before.json"
    data.write_text(json.dumps({"quick": False, "families": before, "wrong_models": []}))
    monkeypatch.setattr(run, "RESULTS", data)
    assert run.main(["--only", "new", "--out", str(tmp_path / "out")]) == 0
    stored = json.loads((tmp_path / "out" / "before.json").read_text())["families"]
    assert list(stored) == ["new", "old"] and stored["old"] == before["old"]
    assert stored["new"]["cases"] == [case(2.0, scale=1.0).as_dict()]
    assert stored["new"]["date"] != "2000-01-01"
    assert "| 0.0, 2000-01-01; " in (tmp_path / "out" / "validation.md").read_text()


def test_only_names_the_families(capsys):
    with pytest.raises(SystemExit):
        run.main(["--only", "silos"])
    assert "invalid choice: 'silos' (choose from" in capsys.readouterr().err


def test_deviation_beyond_the_range_of_a_reference_is_a_miss(tmp_path, families, capsys):
    families["one"] = lambda: [case(3.0, in_range=False)]
    assert run.main(["--out", str(tmp_path)]) == 0
    assert "miss: kind, name: 3 instead of 2 m" in capsys.readouterr().out
    assert case(float("nan"), in_range=False).status == "fail"


def test_page_of_the_documentation_equals_its_stored_data():
    stored = json.loads(STORED.read_text(encoding="utf-8"))
    page = (DOCS / "pages" / "validation.md").read_text(encoding="utf-8")
    assert page == run.rendered(stored)


def test_stored_cases_are_within_the_allowed_deviations():
    stored = json.loads(STORED.read_text(encoding="utf-8"))
    families = stored["families"].values()
    cases = [ValidationCase.from_dict(each) for family in families for each in family["cases"]]
    assert set(stored["families"]) == set(run.all_families())
    assert len(cases) > 100 and not stored["quick"]
    assert [each.name for each in cases if each.status == "fail"] == []
