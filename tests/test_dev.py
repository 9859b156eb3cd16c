"""tools/dev.py: installed packages, reuse of an environment, and error messages, without downloads."""

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
    """The script, loaded from a copy of the project; `dev.calls` records the commands instead of executing
    them."""
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
    """The set-up commands of one start: the word venv for a new environment, and the target of pip."""
    dev.calls.clear()
    dev.refuse_what_cannot_work()
    dev.install(dev.EXTRAS[verb])
    return ["venv" if "venv" in call else call[-1].removeprefix(str(dev.ROOT)) for call in dev.calls]


def test_pinned_versions_and_required_extras_are_installed_once_and_again_after_changes(dev):
    assert set_up(dev, "run") == ["venv", ""]
    assert dev.calls[-1][-4:-2] == ["-c", str(dev.ROOT / "constraints.txt")]
    assert set_up(dev, "check") == ["[dev]"]
    assert set_up(dev, "check") == set_up(dev, "run") == []
    assert set_up(dev, "docs") == ["[dev,docs,plot]"]
    for name in ("pyproject.toml", "constraints.txt"):
        with (dev.ROOT / name).open("a") as file:
            file.write("# changed\n")
        assert set_up(dev, "run") == ["[dev,docs,plot]"]


@pytest.mark.parametrize("change", ["python", "folder", "failure"])
def test_failed_install_another_python_or_a_moved_checkout_gets_a_new_environment(dev, monkeypatch, change):
    dev.pip_fails = change == "failure"
    if change == "failure":
        with pytest.raises(SystemExit, match="Installing granflow failed"):
            set_up(dev, "run")
        dev.pip_fails = False
    else:
        set_up(dev, "run")
    if change == "python":
        monkeypatch.setattr(sys, "version_info", (3, 13 if sys.version_info[1] != 13 else 12, 0))
    elif change == "folder":
        dev.STAMP.write_text(dev.STAMP.read_text().replace(str(dev.ROOT), "/elsewhere"))
    assert set_up(dev, "run") == ["venv", ""]


def test_environment_of_another_tool_or_checkout_is_not_overwritten(dev, tmp_path):
    dev.ENVIRONMENT.mkdir()
    (dev.ENVIRONMENT / "precious").touch()
    with pytest.raises(SystemExit, match="was not made by tools/dev.py: move or remove it"):
        set_up(dev, "run")
    other = dev.ENVIRONMENT.rename(tmp_path / "other")
    (other / dev.STAMP.name).write_text("python 3.11 in /elsewhere\n")
    dev.ENVIRONMENT.symlink_to(other)
    with pytest.raises(SystemExit, match="is a link to the environment of another checkout"):
        set_up(dev, "run")
    assert (other / "precious").exists()


def test_unsupported_python_or_a_missing_venv_module_is_rejected_in_one_sentence(dev, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(importlib.util, "find_spec", lambda name: None if name == "ensurepip" else name)
        with pytest.raises(SystemExit, match=r"lacks its module ensurepip: .*apt install python3\.\d+-venv"):
            set_up(dev, "run")
    for version in ((3, 9, 18), (3, 15, 0)):
        monkeypatch.setattr(sys, "version_info", version)
        with pytest.raises(SystemExit, match=r"needs Python 3\.10 to 3\.14, but this is 3\.\d+: .*\.$"):
            set_up(dev, "run")


@pytest.mark.skipif(os.name != "posix", reason="a shell script replaces Python here")
def test_exit_code_and_arguments_pass_through_and_usage_is_printed(dev, capsys):
    set_up(dev, "run")
    dev.environment_python().write_text('#!/bin/sh\necho "$@"\nexit 7\n')
    dev.environment_python().chmod(0o755)
    command = [sys.executable, str(dev.ROOT / "tools" / "dev.py"), "run", "my scene.yaml", "--until", "1"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (7, "-m granflow run my scene.yaml --until 1\n", "")
    assert dev.main(["bake"]) == 2 and dev.main(["--help"]) == 0
    assert "python3 tools/dev.py run SCENE" in capsys.readouterr().out


def test_script_parses_on_python_3_7_and_readme_and_ci_use_it():
    ast.parse((ROOT / "tools" / "dev.py").read_text(), feature_version=(3, 7))
    for name in ("README.md", ".ci/run"):
        assert "python3 tools/dev.py test" in (ROOT / name).read_text().splitlines(), name
