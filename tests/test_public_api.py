"""The names that the package exports."""

import subprocess
import sys

import granflow


def test_package_shows_public_names_only():
    assert set(dir(granflow)) == {*granflow.__all__, "__version__"}


def test_each_public_name_can_be_imported():
    for name in granflow.__all__:
        assert getattr(granflow, name).__name__ == name


def test_reading_a_scene_does_not_import_taichi():
    code = "import sys; from granflow import Scene, SceneError, load_scene; sys.exit('taichi' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
