"""A run that exceeds the free memory of machine and control groups is rejected before memory is allocated."""

import os
import re
from types import SimpleNamespace

import pytest
from plan.scenes import TEXT

from granflow.cli.main import main
from granflow.engine import backend as device_memory
from granflow.engine.backend import VulkanDevice, free_device_memory
from granflow.errors import SceneError
from granflow.load import load_scene
from granflow.plan import cost as memory_check
from granflow.plan.build import plan_for

GIB = 2**30


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A synthetic machine: builds its available memory [bytes] and the files of its control groups."""
    monkeypatch.setattr("granflow.io.machine.ROOT", tmp_path)

    def build(available, membership="0::/", files=()):
        monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(available=available))
        for name, text in {"proc/self/cgroup": membership, **dict(files)}.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(f"{text}\n")

    return build


JOB, STEP, OLD = (f"sys/fs/cgroup/{path}/memory" for path in ("job", "job/step", "memory/a"))


@pytest.mark.parametrize(("membership", "files", "expected"), [
    ("0::/job", {f"{JOB}.max": "max", f"{JOB}.current": GIB, f"{JOB}.stat": "file 0"}, 8 * GIB),
    ("1:cpu:/x\n0::/job/step",
     {f"{STEP}.max": 6 * GIB, f"{STEP}.current": GIB, f"{STEP}.stat": "inactive_file 0",
      f"{JOB}.max": 4 * GIB, f"{JOB}.current": 3 * GIB, f"{JOB}.stat": f"inactive_file {GIB // 2}"},
     4 * GIB - 3 * GIB + GIB // 2),
    ("9:pids:/\n4:cpu,memory:/a",
     {f"{OLD}.limit_in_bytes": 2 * GIB, f"{OLD}.usage_in_bytes": GIB,
      f"{OLD}.stat": "cache 5\ntotal_inactive_file 4096"}, GIB + 4096),
], ids=["without limits", "limit of the parent", "version 1"])  # fmt: skip
def test_free_memory_is_that_of_the_machine_and_of_its_control_groups(machine, membership, files, expected):
    """Cached files of a group count as free; the machine has 8 GiB."""
    machine(8 * GIB, membership, files)
    assert memory_check.available_memory() == expected


def lattice(folder, count):
    path = folder / "many.yaml"
    path.write_text(TEXT.replace("count: 10\n", f"count: {count}\n"))
    return path


def fitting_count(error):
    return int(re.search(r"lower the count to about (\d+)", str(error.value))[1])


def test_run_that_does_not_fit_is_rejected_before_particles_are_placed(machine, tmp_path):
    machine(GIB)
    with pytest.raises(SceneError, match="300000000 particles .* but only 1.07 GB are free: ") as error:
        memory_check.refuse_without_memory(plan_for(load_scene(lattice(tmp_path, 300_000_000))))
    fitting = plan_for(load_scene(lattice(tmp_path, fitting_count(error))))
    assert 0.7 * GIB < memory_check.required_memory(fitting) < GIB


@pytest.mark.parametrize(("available", "warned"), [(0.9, True), (1.1, True), (1.3, False)])
def test_check_warns_and_places_no_particles_that_do_not_fit(machine, tmp_path, capsys, available, warned):
    path = lattice(tmp_path, 10)
    machine(int(available * memory_check.required_memory(plan_for(load_scene(path)))))
    assert main(["check", str(path)]) == 0
    output = capsys.readouterr()
    assert ("particles need about" in output.err) == warned
    assert ("was not checked" in output.out) == (available < 1.0)


@pytest.mark.skipif(os.name != "posix", reason="a shell script stands for nvidia-smi")
def test_free_memory_of_a_gpu_is_that_of_the_first_visible_one(tmp_path, monkeypatch):
    """nvidia-smi prints MiB; a device of Vulkan that is a processor counts only if there is no GPU."""
    program = tmp_path / "nvidia-smi"
    program.write_text('#!/bin/sh\ntest "$1" = --id=3 && echo 7\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3,1")
    assert free_device_memory("cuda") == 7 * 2**20
    devices = [VulkanDevice("llvmpipe", "Mesa", True, free=5), VulkanDevice("A100", "NVIDIA", False, free=7)]
    monkeypatch.setattr(device_memory, "vulkan_devices", lambda: devices)
    assert free_device_memory("vulkan") == 7


@pytest.mark.parametrize(("count", "shortfall", "largest", "message"), [
    (300_000, 1, None, "GB on the GPU, but only .* are free"),
    (30_000_000, None, 2**32, r"in one buffer, but this GPU allows at most 4\.29 GB"),
])  # fmt: skip
def test_run_on_a_gpu_that_does_not_fit_is_rejected_with_a_count_that_fits(
    tmp_path, count, shortfall, largest, message
):
    """The memory of the GPU lacks one byte, or is not known and its largest buffer has 4 GiB."""
    plan = plan_for(load_scene(lattice(tmp_path, count)), on_gpu=True)
    needed = memory_check.estimate_memory(plan, "f64").total
    memory_check.refuse_without_device_memory(plan, needed, None)
    available = shortfall and needed - shortfall
    with pytest.raises(SceneError, match=message) as error:
        memory_check.refuse_without_device_memory(plan, available, largest)
    fitting = plan_for(load_scene(lattice(tmp_path, fitting_count(error))), on_gpu=True)
    memory_check.refuse_without_device_memory(fitting, available, largest)
    assert memory_check.estimate_memory(fitting, "f64").total > 0.5 * min(needed, largest or needed)


def test_neighbor_lists_that_no_longer_fit_into_a_gpu_are_rejected(tmp_path):
    plan = plan_for(load_scene(lattice(tmp_path, 300_000)), on_gpu=True)
    grown = plan.capacities.grown(2 * plan.capacities.list_entries, 0)
    needed = memory_check.estimate_memory(plan, "f64", grown).total
    assert needed > memory_check.estimate_memory(plan, "f64").total
    memory_check.refuse_growth(plan, grown, needed, None)
    for available, largest in ((needed - 1, None), (None, needed // 10)):
        with pytest.raises(SceneError, match="no longer fit into the memory of the GPU"):
            memory_check.refuse_growth(plan, grown, available, largest)


def test_counts_above_the_id_limit_are_rejected_on_any_machine(tmp_path, capsys):
    assert main(["check", str(lattice(tmp_path, 2_000_000_000))]) == 2
    assert "2000000000 particles are requested, but about " in capsys.readouterr().err
