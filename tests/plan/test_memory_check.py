"""A run that exceeds the free memory of machine and control groups is rejected before memory is allocated."""

import os
import re
from types import SimpleNamespace

import pytest
from plan.scenes import TEXT, line_of

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
    proc = tmp_path / "proc"
    groups = tmp_path / "sys" / "fs" / "cgroup"
    monkeypatch.setattr("granflow.io.machine.ROOT", tmp_path)

    def build(available, membership="0::/", **files):
        (proc / "self").mkdir(parents=True)
        monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(available=available))
        (proc / "self" / "cgroup").write_text(membership + "\n")
        for name, text in files.items():
            path = groups / name.replace("__", "/")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.with_name(path.name.replace("_of_", ".")).write_text(f"{text}\n")

    return build


@pytest.mark.parametrize(("available", "membership", "files", "expected"), [
    (3 * GIB, "0::/me",
     {"me__memory_of_max": "max", "me__memory_of_current": GIB, "me__memory_of_stat": "file 0"}, 3 * GIB),
    (8 * GIB, "1:cpu:/x\n0::/job/step",
     {"job__step__memory_of_max": 6 * GIB, "job__step__memory_of_current": GIB,
      "job__step__memory_of_stat": "inactive_file 0", "job__memory_of_max": 4 * GIB,
      "job__memory_of_current": 3 * GIB, "job__memory_of_stat": f"inactive_file {GIB // 2}"},
     4 * GIB - 3 * GIB + GIB // 2),
    (8 * GIB, "9:pids:/\n4:cpu,memory:/a",
     {"memory__a__memory_of_limit_in_bytes": 2 * GIB, "memory__a__memory_of_usage_in_bytes": GIB,
      "memory__a__memory_of_stat": "cache 5\ntotal_inactive_file 4096"}, GIB + 4096),
], ids=["without limits", "limit of the parent", "version 1"])  # fmt: skip
def test_free_memory_is_that_of_the_machine_and_of_its_control_groups(
    machine, available, membership, files, expected
):
    """Cached files of a group count as free."""
    machine(available, membership, **files)
    assert memory_check.available_memory() == expected


def lattice(folder, count):
    path = folder / "many.yaml"
    path.write_text(TEXT.replace("count: 10\n", f"count: {count}\n"))
    return path


def test_run_that_does_not_fit_is_rejected_before_particles_are_placed(machine, tmp_path):
    machine(GIB)
    path = lattice(tmp_path, 300_000_000)
    with pytest.raises(SceneError) as refused:
        memory_check.refuse_without_memory(plan_for(load_scene(path)))
    (message,) = refused.value.problems
    assert message.startswith(f"{path}:{line_of('count: 10')}:12: 300000000 particles need about ")
    assert "GB of memory, but only 1.07 GB are free: lower the count to about " in message
    assert message.endswith("set run.precision to mixed, or use a machine with more memory.")
    fitting = int(message.partition("count to about ")[2].partition(",")[0])
    assert 0.7 * GIB < memory_check.required_memory(plan_for(load_scene(lattice(tmp_path, fitting)))) < GIB


@pytest.mark.parametrize(("available", "warned"), [(0.9, True), (1.1, True), (1.3, False)])
def test_check_warns_and_places_no_particles_that_do_not_fit(machine, tmp_path, capsys, available, warned):
    path = lattice(tmp_path, 10)
    needed = memory_check.required_memory(plan_for(load_scene(path)))
    machine(int(available * needed))
    assert main(["check", str(path)]) == 0
    output = capsys.readouterr()
    assert ("particles need about" in output.err) == warned
    assert ("was not checked" in output.out) == (available < 1.0)


NVIDIA_SMI = """#!/bin/sh
test "$1" = --id=3 && echo 7
"""


@pytest.mark.skipif(os.name != "posix", reason="a shell script stands for nvidia-smi")
def test_free_memory_of_cuda_is_that_of_the_first_visible_gpu(tmp_path, monkeypatch):
    """nvidia-smi prints MiB; the GPU is the first in CUDA_VISIBLE_DEVICES."""
    program = tmp_path / "nvidia-smi"
    program.write_text(NVIDIA_SMI)
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3,1")
    assert free_device_memory("cuda") == 7 * 2**20
    program.unlink()
    assert free_device_memory("cuda") is None


def test_free_memory_of_vulkan_is_that_of_the_gpu(monkeypatch):
    devices = [VulkanDevice("llvmpipe", "Mesa", True, free=5), VulkanDevice("A100", "NVIDIA", False, free=7)]
    monkeypatch.setattr(device_memory, "vulkan_devices", lambda: devices)
    assert free_device_memory("vulkan") == 7
    monkeypatch.setattr(device_memory, "vulkan_devices", lambda: [])
    assert free_device_memory("vulkan") is None


def fitting_count(error):
    return int(
        re.search(r"lower the count to about (\d+) or set run.precision to mixed\.$", str(error.value))[1]
    )


def test_run_on_a_gpu_that_does_not_fit_is_rejected_with_a_count_that_fits(tmp_path):
    plan = plan_for(load_scene(lattice(tmp_path, 300_000)), on_gpu=True)
    needed = memory_check.estimate_memory(plan, plan.scene.run.precision).total
    memory_check.refuse_without_device_memory(plan, needed, None)
    memory_check.refuse_without_device_memory(plan, None, None)  # unknown
    with pytest.raises(SceneError, match=r"GB on the GPU, but only .* are free: lower") as error:
        memory_check.refuse_without_device_memory(plan, needed - 1, None)
    fitting = plan_for(load_scene(lattice(tmp_path, fitting_count(error))), on_gpu=True)
    memory_check.refuse_without_device_memory(fitting, needed - 1, None)


def test_array_above_the_largest_buffer_is_rejected_with_a_count_that_fits(tmp_path):
    plan = plan_for(load_scene(lattice(tmp_path, 30_000_000)), on_gpu=True)
    assert memory_check.estimate_memory(plan, "f64").total > 3 * 2**32, "in several buffers"
    with pytest.raises(
        SceneError, match=r"in one buffer, but this GPU allows at most 4\.29 GB: lower"
    ) as error:
        memory_check.refuse_without_device_memory(plan, None, 2**32)
    fitting = plan_for(load_scene(lattice(tmp_path, fitting_count(error))), on_gpu=True)
    memory_check.refuse_without_device_memory(fitting, None, 2**32)
    assert memory_check.estimate_memory(fitting, "f64").total > 2**32


def test_neighbor_lists_that_no_longer_fit_into_a_gpu_are_rejected(tmp_path):
    plan = plan_for(load_scene(lattice(tmp_path, 300_000)), on_gpu=True)
    grown = plan.capacities.grown(2 * plan.capacities.list_entries, 0)
    needed = memory_check.estimate_memory(plan, "f64", grown).total
    assert needed > memory_check.estimate_memory(plan, "f64").total
    memory_check.refuse_growth(plan, grown, needed, None)
    for available, largest in ((needed - 1, None), (None, needed // 10)):
        with pytest.raises(
            SceneError, match=r"no longer fit into the memory of the GPU, because all fields need"
        ):
            memory_check.refuse_growth(plan, grown, available, largest)


def test_counts_above_the_id_limit_are_rejected_on_any_machine(tmp_path, capsys):
    path = lattice(tmp_path, 2_000_000_000)
    assert main(["check", str(path)]) == 2
    message, closing = capsys.readouterr().err.splitlines()
    assert "2000000000 particles are requested, but about " in message
    assert closing == "1 problem found."
