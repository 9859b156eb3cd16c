"""tools/dev.py: installed packages, reuse of an environment, and error messages. The tests download
nothing."""

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


def test_first_start_installs_pinned_versions_and_developer_tools_only_if_required(dev):
    assert set_up(dev, "run") == ["venv", ""]
    assert dev.calls[-1][-4:-2] == ["-c", str(dev.ROOT / "constraints.txt")]
    assert set_up(dev, "check") == ["[dev]"]
    assert set_up(dev, "check") == set_up(dev, "run") == []


def test_installed_extras_are_kept_on_reinstall(dev):
    set_up(dev, "slow")
    (dev.ROOT / "constraints.txt").write_text("numpy==2.2.6\n")
    assert set_up(dev, "run") == [f"[{','.join(sorted(dev.EXTRAS['slow']))}]"]


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


@pytest.mark.parametrize("change", ["python", "folder"])
def test_another_python_or_a_moved_checkout_gets_a_new_environment(dev, monkeypatch, change):
    set_up(dev, "run")
    if change == "python":
        monkeypatch.setattr(sys, "version_info", (3, 13 if sys.version_info[1] != 13 else 12, 0))
    else:
        dev.STAMP.write_text(dev.STAMP.read_text().replace(str(dev.ROOT), "/elsewhere"))
    assert set_up(dev, "run") == ["venv", ""]


def test_environment_of_another_tool_is_not_overwritten(dev):
    dev.ENVIRONMENT.mkdir()
    (dev.ENVIRONMENT / "precious").touch()
    with pytest.raises(SystemExit, match="was not made by tools/dev.py: move or remove it"):
        set_up(dev, "run")
    assert (dev.ENVIRONMENT / "precious").exists()


def test_linked_environment_of_another_checkout_keeps_its_stamp(dev, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    (other / dev.STAMP.name).write_text("python 3.11 in /elsewhere\n")
    dev.ENVIRONMENT.symlink_to(other)
    with pytest.raises(SystemExit, match="is a link to the environment of another checkout"):
        set_up(dev, "run")
    assert (other / dev.STAMP.name).read_text() == "python 3.11 in /elsewhere\n"


def test_unsupported_python_or_a_missing_venv_module_is_rejected_in_one_sentence(dev, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(importlib.util, "find_spec", lambda name: None if name == "ensurepip" else name)
        with pytest.raises(SystemExit, match=r"lacks its module ensurepip: .*apt install python3\.\d+-venv"):
            set_up(dev, "run")
    for version in ((3, 9, 18), (3, 15, 0)):
        monkeypatch.setattr(sys, "version_info", version)
        with pytest.raises(SystemExit, match=r"needs Python 3\.10 to 3\.14, but this is 3\.\d+: .*\.$"):
            set_up(dev, "run")


def test_script_parses_on_python_3_7():
    ast.parse((ROOT / "tools" / "dev.py").read_text(), feature_version=(3, 7))


def test_docs_are_built_with_their_extras(dev, monkeypatch):
    assert set_up(dev, "docs")[-1] == "[docs,plot]"
    monkeypatch.chdir(dev.ROOT)
    command = dev.command_of("docs", ["--quiet"])
    assert command[1:] == ["-m", "mkdocs", "build", "--strict", "--config-file", "docs/mkdocs.yml", "--quiet"]


@pytest.mark.parametrize(("arguments", "status"), [([], 2), (["bake"], 2), (["--help"], 0)])
def test_usage_is_printed_without_a_known_verb(dev, arguments, status, capsys):
    assert dev.main(arguments) == status
    output = capsys.readouterr()
    assert "python3 tools/dev.py run SCENE" in output.out + output.err


@pytest.mark.skipif(os.name != "posix", reason="a shell script replaces Python here")
def test_exit_code_and_arguments_pass_through(dev):
    set_up(dev, "run")
    dev.environment_python().write_text('#!/bin/sh\necho "$@"\nexit 7\n')
    dev.environment_python().chmod(0o755)
    command = [sys.executable, str(dev.ROOT / "tools" / "dev.py"), "run", "my scene.yaml", "--until", "1"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (7, "-m granflow run my scene.yaml --until 1\n", "")


def test_constraints_pin_exact_versions_and_contain_no_host():
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    assert all("==" in line and "/" not in line and "--" not in line for line in lines)


def test_readme_and_ci_use_the_same_command():
    for name in ("README.md", ".ci/run"):
        assert "python3 tools/dev.py test" in (ROOT / name).read_text().splitlines(), name
