"""Fixtures of tests that run the command line in separate processes."""

import pytest
from resume.faults import SCENE


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A directory with SCENE as beads.yaml."""
    directory = tmp_path_factory.mktemp("home")
    (directory / "beads.yaml").write_text(SCENE)
    return directory
