"""Suggestions for unknown and renamed keys."""

import pytest

from granflow.scene.suggest import RENAMED_KEYS, nearest, suggestion_or_list


@pytest.mark.parametrize(("old", "new"), RENAMED_KEYS.items())
def test_renamed_key_is_reported_with_its_new_name(old, new):
    known = ["material", new, "diameter"]
    assert nearest(old, known) == new
    assert suggestion_or_list(old, known, "keys") == f"{old} was renamed to {new}."


def test_renamed_key_is_not_suggested_if_its_new_name_is_unknown():
    assert nearest("place", ["material", "diameter"]) is None
    assert suggestion_or_list("place", ["material"], "keys") == "The keys are material"
