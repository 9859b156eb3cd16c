"""`granflow cache`, and runs with a cache folder that cannot be written, is shared, or contains a stale
lock."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from granflow.cli.main import main
from granflow.engine.kernel_cache import CACHED_KERNELS as KERNELS
from granflow.engine.kernel_cache import LOCKS
from granflow.kernel_language import KERNELS as LANGUAGE

PAIR = "--law hertz --restitution 0.8 --material stainless_316 --diameter 25.4mm --velocity 0.5"
COLLISION = ("collide", *PAIR.split(), "--json")


def start(cache, *arguments):
    command = [sys.executable, "-m", "granflow", *arguments]
    environment = os.environ | {"GRANFLOW_CACHE": str(cache)}
    return subprocess.Popen(
        command, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def granflow(cache, *arguments):
    process = start(cache, *arguments)
    output, errors = process.communicate(timeout=200)
    assert process.returncode == 0, errors
    return output, errors


def kernels(folder):
    return {path.name for path in folder.glob(KERNELS)}


@pytest.fixture(scope="module")
def filled_cache(tmp_path_factory):
    """A cache folder filled by two simultaneous processes, and their outputs."""
    folder = tmp_path_factory.mktemp("cache") / "made" / "by granflow"
    processes = [start(folder, *COLLISION) for _ in range(2)]
    output = [process.communicate(timeout=200) for process in processes]
    assert [process.returncode for process in processes] == [0, 0], output
    return folder, output


def test_two_processes_share_a_cache(filled_cache):
    folder, output = filled_cache
    assert output[0] == output[1]
    assert output[0][1] == ""
    assert kernels(folder)


def test_second_run_compiles_nothing_and_removes_a_stale_lock(filled_cache):
    folder, output = filled_cache
    before = kernels(folder)
    lock = folder / LOCKS[LANGUAGE]
    lock.touch()
    os.utime(lock, (time.time() - 3600.0,) * 2)
    assert granflow(folder, *COLLISION) == output[0]
    assert kernels(folder) == before
    assert not lock.exists()


def test_damaged_kernels_are_recompiled(filled_cache, tmp_path):
    folder, output = filled_cache
    for path in filter(Path.is_file, folder.rglob("*")):
        damaged = tmp_path / path.relative_to(folder)
        damaged.parent.mkdir(exist_ok=True)
        damaged.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert granflow(tmp_path, *COLLISION)[0] == output[0][0]


def test_unwritable_cache_is_reported_once(filled_cache, tmp_path):
    (tmp_path / "file").touch()
    output, errors = granflow(tmp_path / "file" / "cache", *COLLISION)
    assert output == filled_cache[1][0][0]
    assert "cannot be written" in errors and "GRANFLOW_CACHE" in errors
    assert len(errors.splitlines()) == 1


def test_cache_is_listed_and_cleared_without_other_files(tmp_path, monkeypatch, capsys):
    def cache(*options):
        assert main(["cache", *options]) == 0
        return capsys.readouterr().out

    monkeypatch.setenv("GRANFLOW_CACHE", str(tmp_path))
    (tmp_path / "one.tic").write_bytes(b"x" * 600_000)
    (tmp_path / "ticache.tcb").write_bytes(b"x" * 600_000)
    (tmp_path / "notes.txt").write_text("other")
    (tmp_path / "kernel_compilation_manager").mkdir()
    (tmp_path / "kernel_compilation_manager" / "one.qdc").write_bytes(b"x" * 600_000)
    assert f"{tmp_path}: 2 compiled kernels, 1.8 MB cached" in cache()
    assert "1.8 MB deleted" in cache("--clear")
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["notes.txt"]
    assert "0 compiled kernels" in cache()
    monkeypatch.delenv("GRANFLOW_CACHE")
    monkeypatch.setenv("HOME", "/dev/null")
    assert "0 compiled kernels" in cache(), "also without a directory HOME"
