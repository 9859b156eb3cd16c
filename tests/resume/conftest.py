"""What tests with processes of their own share."""

import pytest
from resume.faults import SCENE


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A directory that holds the scene as beads.yaml."""
    directory = tmp_path_factory.mktemp("home")
    (directory / "beads.yaml").write_text(SCENE)
    return directory
