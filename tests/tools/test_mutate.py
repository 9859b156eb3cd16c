"""tools/mutate.py: its mutations fit the source, and the tests that they name notice every one."""

import importlib
from dataclasses import replace
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def mutate(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    return importlib.import_module("mutate")


def test_every_mutation_fits_the_source_and_names_tests_that_exist(mutate):
    assert mutate.problems(mutate.MUTATIONS) == []
    assert len({each.name for each in mutate.MUTATIONS}) == len(mutate.MUTATIONS) >= 40
    for each in mutate.MUTATIONS:
        assert each.old != each.new
        for test in each.tests:
            file, _, name = test.partition("::")
            assert f"def {name.partition('[')[0]}(" in (ROOT / file).read_text(encoding="utf-8") or not name, test


def test_a_mutation_whose_text_is_gone_is_reported(mutate, monkeypatch, capsys):
    first = mutate.MUTATIONS[0]
    gone, moved = replace(first, old="no such text"), replace(first, file="granflow/none.py")
    (sentence,) = mutate.problems([gone])
    assert sentence == (
        f"{first.name}: {first.file} contains the text 'no such text' 0 times instead of once; "
        "update tools/mutations.py."
    )
    assert mutate.problems([moved]) == [f"{first.name}: granflow/none.py does not exist; update tools/mutations.py."]
    monkeypatch.setattr(mutate, "MUTATIONS", (gone,))
    monkeypatch.setattr("sys.argv", ["mutate.py"])
    assert mutate.main() == 1
    assert sentence in capsys.readouterr().err


def test_killed_survived_and_broken_are_told_apart(mutate, tmp_path):
    """A copy of its own with one function and one test."""
    (tmp_path / "double.py").write_text("def double(x):\n    return 2 * x\n")
    (tmp_path / "test_double.py").write_text(
        "from double import double\n\n\ndef test_it():\n    assert double(2) == 4\n"
    )
    mutation = mutate.Mutation("double", "double.py", "2 * x", "3 * x", ("test_double.py",))
    verdicts = {
        "3 * x": "killed",
        "x + x": "SURVIVED",
        "2 *": "ERROR (pytest ended with 2)",
    }
    for new, verdict in verdicts.items():
        assert mutate.verdict(tmp_path, replace(mutation, new=new), tmp_path / "kernels") == verdict
    assert (tmp_path / "double.py").read_text() == "def double(x):\n    return 2 * x\n"


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_no_mutation_survives(mutate):
    verdicts = mutate.run(mutate.MUTATIONS, 2)
    assert [(each.name, verdict) for each, verdict in verdicts if not verdict.startswith("killed")] == []
