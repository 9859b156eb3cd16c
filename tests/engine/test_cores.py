"""The default thread count follows CPU affinity, cgroup quota and Slurm; --threads cannot exceed the
cores."""

import re

import pytest

from granflow.errors import GranflowError
from granflow.io import machine
from granflow.io.machine import allowed_cores, quota_cores, worker_count

V2, V1 = "0::/user/job\n", "5:memory:/job\n4:cpu,cpuacct:/job\n"


@pytest.fixture
def write_system_files(tmp_path, monkeypatch):
    """Writes the files of /proc and /sys from which the quota is read."""
    monkeypatch.setattr(machine, "ROOT", tmp_path)
    return lambda groups, texts: _write(tmp_path, groups, texts)


def _write(root, groups, texts):
    group_files = {f"sys/fs/cgroup/{name}": text for name, text in texts.items()}
    for name, text in {"proc/self/cgroup": groups, **group_files}.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


@pytest.mark.parametrize(
    ("texts", "cores"),
    [
        ({"user/job/cpu.max": "200000 100000"}, 2),
        ({"user/job/cpu.max": "150000 100000"}, 2),  # 1.5 cores: two threads can use them, one cannot
        ({"user/job/cpu.max": "50000 100000"}, 1),
        ({"user/job/cpu.max": "max 100000"}, None),
        ({"user/job/cpu.max": "max 100000", "user/cpu.max": "300000 100000"}, 3),
        ({"user/job/cpu.max": "400000 100000", "cpu.max": "100000 100000"}, 1),
        ({"cpu.max": "nonsense"}, None),
        ({}, None),
    ],
)
def test_cgroup_v2_quota_limits_the_cores(write_system_files, texts, cores):
    write_system_files(V2, texts)
    assert quota_cores({}) == cores


@pytest.mark.parametrize(("quota", "cores"), [("300000", 3), ("-1", None), ("0", None)])
@pytest.mark.parametrize("folder", ["cpu", "cpu,cpuacct"])
def test_cgroup_v1_quota_limits_the_cores(write_system_files, folder, quota, cores):
    texts = {f"{folder}/job/cpu.cfs_quota_us": quota, f"{folder}/job/cpu.cfs_period_us": "100000"}
    write_system_files(V1, texts)
    assert quota_cores({}) == cores


SLURM = [("3", 3), ("0", None), ("-2", None), ("many", None), ("", None)]


@pytest.mark.parametrize(("value", "cores"), SLURM)
def test_slurm_limits_the_cores_and_the_smaller_limit_applies(write_system_files, value, cores):
    assert quota_cores({"SLURM_CPUS_PER_TASK": value}) == cores
    write_system_files(V2, {"cpu.max": "200000 100000"})
    assert quota_cores({"SLURM_CPUS_PER_TASK": value}) == 2
    assert quota_cores({"SLURM_CPUS_PER_TASK": "1"}) == 1


def test_threads_are_the_smaller_of_affinity_and_quota_and_more_are_reduced_with_a_warning():
    for affinity, quota, count in ((8, 3, 3), (2, 5, 2), (4, 4, 4)):
        assert worker_count(None, affinity, quota) == (count, "")
    count, warning = worker_count(8, affinity=2, quota=1)
    assert count == 2
    assert warning == "--threads 8: this process can use 2 cores, so granflow uses 2."
    assert worker_count(2, affinity=2, quota=1) == (2, "")


def test_affinity_replaces_the_core_count_of_the_machine(monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {3}, raising=False)
    monkeypatch.setattr("os.cpu_count", lambda: 64)
    assert allowed_cores() == 1


@pytest.mark.parametrize("threads", [0, 2.5, "2"])
def test_a_number_of_threads_that_is_not_valid_is_refused(threads):
    message = f"threads is {threads!r}; give a whole number of at least 1, or None for all available cores."
    with pytest.raises(GranflowError, match=f"^{re.escape(message)}$"):
        worker_count(threads)
