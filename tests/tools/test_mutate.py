"""tools/mutate.py: the mutations apply to the source, and the named tests detect each of them."""

import importlib
from dataclasses import replace
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def mutate():
    return importlib.import_module("mutate")


def test_mutations_apply_to_the_source_and_name_existing_tests(mutate):
    assert mutate.problems(mutate.MUTATIONS) == []
    assert len({each.name for each in mutate.MUTATIONS}) == len(mutate.MUTATIONS) >= 40
    for each in mutate.MUTATIONS:
        assert each.old != each.new
        for test in each.tests:
            file, _, name = test.partition("::")
            assert (
                f"def {name.partition('[')[0]}(" in (ROOT / file).read_text(encoding="utf-8") or not name
            ), test


def test_mutation_without_matching_text_is_reported(mutate, monkeypatch, capsys):
    first = mutate.MUTATIONS[0]
    stale = replace(first, old="no such text")
    without_file = replace(first, file="granflow/none.py")
    (message,) = mutate.problems([stale])
    assert message == (
        f"{first.name}: {first.file} contains the text 'no such text' 0 times instead of once; "
        "update tools/mutations.py."
    )
    assert mutate.problems([without_file]) == [
        f"{first.name}: granflow/none.py does not exist; update tools/mutations.py."
    ]
    monkeypatch.setattr(mutate, "MUTATIONS", (stale,))
    monkeypatch.setattr("sys.argv", ["mutate.py"])
    assert mutate.main() == 1
    assert message in capsys.readouterr().err


def test_killed_surviving_and_failing_mutations_are_distinguished(mutate, tmp_path):
    """In a separate folder with one function and one test."""
    (tmp_path / "double.py").write_text("def double(x):\n    return 2 * x\n")
    (tmp_path / "test_double.py").write_text(
        "from double import double\n\n\ndef test_it():\n    assert double(2) == 4\n"
    )
    mutation = mutate.Mutation("double", "double.py", "2 * x", "3 * x", ("test_double.py",))
    statuses = {
        "3 * x": "killed",
        "x + x": "SURVIVED",
        "2 *": "ERROR (pytest ended with 2)",
    }
    for new, status in statuses.items():
        assert mutate.status_of(tmp_path, replace(mutation, new=new), tmp_path / "kernels") == status
    assert (tmp_path / "double.py").read_text() == "def double(x):\n    return 2 * x\n"


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_no_mutation_survives(mutate):
    statuses = mutate.run(mutate.MUTATIONS, 2)
    assert [(each.name, status) for each, status in statuses if not status.startswith("killed")] == []
