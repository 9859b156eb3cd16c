"""Cache folders of kernels that are damaged, locked or cannot be written; `granflow cache`."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from granflow.cli.main import main
from granflow.engine.kernel_cache import CACHED_KERNELS, LOCKS, usable_folder
from granflow.kernel_language import KERNELS

PAIR = "--law hertz --restitution 0.8 --material stainless_316 --diameter 25.4mm --velocity 0.5"


def collide(cache, *options):
    """Output of a collision with a cache folder, in a process of its own."""
    command = [sys.executable, "-m", "granflow", "collide", *PAIR.split(), *options]
    environment = os.environ | {"GRANFLOW_CACHE": str(cache)}
    done = subprocess.run(command, env=environment, text=True, capture_output=True, timeout=200)
    assert done.returncode == 0 and "Traceback" not in done.stderr
    return done.stdout


def test_damaged_cache_is_repaired(tmp_path):
    """All of its files are cut off. All processes of the tests share their cache."""
    folder = tmp_path / "made" / "by granflow"
    restitution = json.loads(collide(folder, "--json"))["restitution"]
    assert restitution == pytest.approx(0.8, rel=2e-3)
    assert list(folder.glob(CACHED_KERNELS))
    for path in filter(Path.is_file, folder.rglob("*")):
        os.truncate(path, path.stat().st_size // 2)
    table = collide(folder).splitlines()
    assert ["restitution", f"{restitution:.7g}", "0.8"] in [line.split() for line in table]


def test_stale_lock_is_removed_and_an_unwritable_folder_replaced(tmp_path, monkeypatch, caplog):
    """The lock of a process killed an hour ago would disable the cache; a lock in use stays."""
    monkeypatch.setenv("GRANFLOW_CACHE", str(tmp_path))
    lock = tmp_path / LOCKS[KERNELS]
    lock.parent.mkdir(exist_ok=True)
    lock.touch()
    assert usable_folder() == tmp_path and lock.exists()
    os.utime(lock, (time.time() - 3600.0,) * 2)
    assert usable_folder() == tmp_path and not lock.exists() and not caplog.text
    (tmp_path / "file").touch()
    monkeypatch.setenv("GRANFLOW_CACHE", str(tmp_path / "file" / "cache"))
    folder = usable_folder()
    assert folder.is_dir() and "file/cache cannot be written" in caplog.text
    folder.rmdir()


def test_cache_is_listed_and_cleared_without_other_files(tmp_path, monkeypatch, capsys):
    def cache(*options):
        assert main(["cache", *options]) == 0
        return capsys.readouterr().out

    monkeypatch.setenv("GRANFLOW_CACHE", str(tmp_path))
    (tmp_path / "kernel_compilation_manager").mkdir()
    for name in ("one.tic", "ticache.tcb", "kernel_compilation_manager/one.qdc"):
        (tmp_path / name).write_bytes(b"x" * 600_000)
    (tmp_path / "notes.txt").write_text("other")
    assert f"{tmp_path}: 2 compiled kernels, 1.8 MB cached" in cache()
    assert "1.8 MB deleted" in cache("--clear")
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["notes.txt"]
    assert "0 compiled kernels" in cache()
    monkeypatch.delenv("GRANFLOW_CACHE")
    monkeypatch.setenv("HOME", "/dev/null")
    assert "0 compiled kernels" in cache(), "also without a directory HOME"
