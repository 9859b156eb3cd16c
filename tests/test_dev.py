"""tools/dev.py: what it installs, when it does not, and what it says when it cannot. Nothing is downloaded here."""

import ast
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def dev(tmp_path, monkeypatch):
    """The script, loaded from a copy of the project; what it would execute lands in `dev.calls`."""
    (tmp_path / "tools").mkdir()
    for name in ("tools/dev.py", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path / name)
    spec = importlib.util.spec_from_file_location("dev_script", tmp_path / "tools" / "dev.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.calls = []
    module.pip_fails = False

    def attempt(command, failure):
        module.calls.append(command)
        if "venv" in command:
            module.environment_python().parent.mkdir(parents=True)
            module.environment_python().touch()
        elif module.pip_fails:
            module.stop(failure)

    monkeypatch.setattr(module, "attempt", attempt)
    monkeypatch.chdir(tmp_path)
    return module


def set_up(dev, verb):
    """What one start would execute to set itself up: the word venv, and pip's target."""
    dev.calls.clear()
    dev.refuse_what_cannot_work()
    dev.install(dev.EXTRAS[verb])
    return ["venv" if "venv" in call else call[-1].removeprefix(str(dev.ROOT)) for call in dev.calls]


def test_first_start_installs_and_second_does_not(dev):
    assert set_up(dev, "test") == ["venv", "[dev]"]
    assert set_up(dev, "test") == []


def test_running_needs_no_tools_for_developers(dev):
    assert set_up(dev, "run") == ["venv", ""]
    assert set_up(dev, "test") == ["[dev]"]
    assert set_up(dev, "run") == []


def test_versions_are_pinned(dev):
    set_up(dev, "run")
    assert dev.calls[-1][-4:-2] == ["-c", str(dev.ROOT / "constraints.txt")]


def test_what_was_there_stays_when_more_is_asked(dev):
    set_up(dev, "slow")
    (dev.ROOT / "constraints.txt").write_text("numpy==2.2.6\n")
    assert set_up(dev, "run") == ["[dev,plot]"]


@pytest.mark.parametrize("name", ["pyproject.toml", "constraints.txt"])
def test_changed_requirements_are_installed(dev, name):
    set_up(dev, "run")
    with (dev.ROOT / name).open("a") as file:
        file.write("# changed\n")
    assert set_up(dev, "run") == [""]


def test_failed_install_is_redone_from_scratch(dev):
    dev.pip_fails = True
    with pytest.raises(SystemExit, match="Installing granflow failed"):
        set_up(dev, "run")
    dev.pip_fails = False
    assert set_up(dev, "run") == ["venv", ""]


def test_another_python_gets_a_new_environment(dev, monkeypatch):
    set_up(dev, "run")
    monkeypatch.setattr(sys, "version_info", (3, 13 if sys.version_info[1] != 13 else 12, 0))
    assert set_up(dev, "run") == ["venv", ""]


def test_moved_checkout_gets_a_new_environment(dev, tmp_path):
    set_up(dev, "run")
    stamp = dev.STAMP.read_text()
    dev.STAMP.write_text(stamp.replace(str(dev.ROOT), "/elsewhere"))
    assert set_up(dev, "run") == ["venv", ""]


def test_environment_of_someone_else_is_left_alone(dev):
    dev.ENVIRONMENT.mkdir()
    (dev.ENVIRONMENT / "precious").touch()
    with pytest.raises(SystemExit, match="was not made by tools/dev.py: move or remove it"):
        set_up(dev, "run")
    assert (dev.ENVIRONMENT / "precious").exists()


@pytest.mark.parametrize("version", [(3, 9, 18), (3, 14, 0)])
def test_wrong_python_is_refused_in_one_sentence(dev, monkeypatch, version):
    monkeypatch.setattr(sys, "version_info", version)
    with pytest.raises(SystemExit, match=r"needs Python 3\.10 to 3\.13, but this is 3\.\d+: .*\.$"):
        set_up(dev, "run")


def test_missing_venv_module_names_the_remedy(dev, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "ensurepip" else name)
    with pytest.raises(SystemExit, match=r"lacks its module ensurepip: .*apt install python3\.\d+-venv"):
        set_up(dev, "run")


def test_old_pythons_can_read_the_script_far_enough_to_refuse():
    ast.parse((ROOT / "tools" / "dev.py").read_text(), feature_version=(3, 7))


@pytest.mark.parametrize(("arguments", "status"), [([], 2), (["bake"], 2), (["--help"], 0)])
def test_usage(dev, arguments, status, capsys):
    assert dev.main(arguments) == status
    shown = capsys.readouterr()
    assert "python3 tools/dev.py run SCENE" in shown.out + shown.err


@pytest.mark.skipif(os.name != "posix", reason="the stand-in for Python is a shell script")
def test_exit_code_and_arguments_pass_through(dev):
    set_up(dev, "run")
    dev.environment_python().write_text('#!/bin/sh\necho "$@"\nexit 7\n')
    dev.environment_python().chmod(0o755)
    command = [sys.executable, str(dev.ROOT / "tools" / "dev.py"), "run", "my scene.yaml", "--until", "1"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (7, "-m granflow run my scene.yaml --until 1\n", "")


def test_constraints_pin_exactly_and_name_no_host():
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    assert all("==" in line and "/" not in line and "--" not in line for line in lines)


def test_readme_and_ci_use_the_same_command():
    for name in ("README.md", ".ci/run"):
        assert "python3 tools/dev.py test" in (ROOT / name).read_text().splitlines(), name
