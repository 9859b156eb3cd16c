"""`granflow cache`, and runs with a cache folder that cannot be written, is shared, or was left locked."""

import os
import subprocess
import sys
import time

import pytest

COLLISION = ("collide", "--material", "stainless_316", "--diameter", "25.4mm", "--velocity", "0.5", "--json")


def start(cache, *arguments):
    command = [sys.executable, "-m", "granflow", *arguments]
    environment = os.environ | {"GRANFLOW_CACHE": str(cache)}
    return subprocess.Popen(command, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def granflow(cache, *arguments):
    process = start(cache, *arguments)
    message, complained = process.communicate(timeout=200)
    assert process.returncode == 0, complained
    return message, complained


def kernels(folder):
    return {path.name for path in folder.glob("*.tic")}


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """A folder after two processes filled it at once, and what they said."""
    folder = tmp_path_factory.mktemp("cache") / "made" / "by granflow"
    both = [start(folder, *COLLISION) for _ in range(2)]
    message = [process.communicate(timeout=200) for process in both]
    assert [process.returncode for process in both] == [0, 0], message
    return folder, message


def test_two_processes_share_a_cache(filled):
    folder, message = filled
    assert message[0] == message[1]
    assert message[0][1] == ""
    assert kernels(folder)


def test_a_second_run_compiles_nothing(filled):
    folder, message = filled
    before = kernels(folder)
    assert granflow(folder, *COLLISION) == message[0]
    assert kernels(folder) == before


def test_a_lock_that_a_killed_process_left_is_broken(filled):
    folder, message = filled
    lock = folder / "ticache.lock"
    lock.touch()
    os.utime(lock, (time.time() - 3600.0,) * 2)
    assert granflow(folder, *COLLISION) == message[0]
    assert not lock.exists()


def test_damaged_kernels_are_compiled_anew(filled, tmp_path):
    folder, message = filled
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert granflow(tmp_path, *COLLISION)[0] == message[0][0]


def test_a_folder_that_cannot_be_written_is_said_once(filled, tmp_path):
    (tmp_path / "file").touch()
    message, complained = granflow(tmp_path / "file" / "cache", *COLLISION)
    assert message == filled[1][0][0]
    assert "cannot be written" in complained and "GRANFLOW_CACHE" in complained
    assert len(complained.splitlines()) == 1


def test_the_cache_is_shown_and_cleared_and_strange_files_stay(tmp_path):
    (tmp_path / "one.tic").write_bytes(b"x" * 600_000)
    (tmp_path / "ticache.tcb").write_bytes(b"x" * 600_000)
    (tmp_path / "notes.txt").write_text("mine")
    assert f"{tmp_path}: 1 compiled kernels, 1.2 MB cached" in granflow(tmp_path, "cache")[0]
    assert "1.2 MB deleted" in granflow(tmp_path, "cache", "--clear")[0]
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]
    assert "0 compiled kernels" in granflow(tmp_path, "cache")[0]
