"""Runs on Vulkan have the bits of the CPU, with one particle per chunk on both."""

import hashlib
from functools import cache

import numpy as np
import pytest
from gpu.scenes import SCENES, WITH_POWERS, shaken_box
from scene_builders import run_to_end
from subprocess_runner import in_subprocess

pytestmark = pytest.mark.gpu

ARRAYS = ("position", "velocity", "angular_velocity", "force", "torque", "coordination_number")
COMPARED = ("particle_count", "contact_count", "overlap_largest", "kinetic_energy")


def state_after(scene, arch, precision, inserted=None):
    """Digest of the particles, walls and wall forces at the end, totals, and the mean position; ids are checked."""
    last, simulation = run_to_end(scene, arch=arch, precision=precision, threads=1)
    ids = last.particles["id"]
    inserted = simulation.engine.accounting.inserted_count
    assert len(set(ids.tolist())) == len(ids) == int(last.totals["particle_count"])
    assert set(ids.tolist()) <= set(range(inserted)), "each id is that of an inserted particle"
    assert len(ids) == inserted or last.totals["deleted_count"] == inserted - len(ids)
    arrays = [np.ascontiguousarray(last.particles[name]) for name in ("id", *ARRAYS) if name in last.particles]
    arrays += [np.asarray(wall.offset) for wall in last.walls.values()] + list(last.impulses.values())
    digest = hashlib.sha256(b"".join(each.tobytes() for each in arrays)).hexdigest()
    timing = simulation.engine.timing
    return {
        "digest": digest, "steps": timing.step_count, "rebuilds": timing.rebuild_count, "growths": timing.growth_count,
        "position": last.particles["position"].mean(axis=0).tolist(), **{name: last.totals[name] for name in COMPARED},
    }  # fmt: skip


def all_states(folder, arch, precision):
    """The final state of each scene; with the reason if a scene failed."""
    found = {}
    for name, build in SCENES.items():
        try:
            found[name] = state_after(build(folder), arch, precision)
        except Exception as error:
            found[name] = {"failed": f"{type(error).__name__}: {error}"[-600:]}
    return found


@cache
def compared(folder, precision):
    """Final states on the CPU and on Vulkan."""
    return [in_subprocess(all_states, folder, arch, precision, seconds=280) for arch in ("cpu", "vulkan")]


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_scenes_have_the_bits_of_the_cpu(vulkan, tmp_path, precision):
    cpu, gpu = compared(str(tmp_path), precision)
    assert not {name: state["failed"] for state in (cpu, gpu) for name, state in state.items() if "failed" in state}
    assert all(state["contact_count"] or state["rebuilds"] > 2 for state in cpu.values())
    different = {name: (cpu[name], gpu[name]) for name in SCENES if cpu[name] != gpu[name]}
    assert set(different) <= WITH_POWERS, different
    for name in WITH_POWERS:
        tolerance = 1e-9 if precision == "f64" else 1e-3
        np.testing.assert_allclose(gpu[name]["position"], cpu[name]["position"], rtol=tolerance)


def long_run(arch, precision):
    """20 000 steps of the shaken box."""
    return state_after(shaken_box(0.08), arch, precision)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_20000_steps_have_the_bits_of_the_cpu(vulkan, precision):
    cpu, gpu = (in_subprocess(long_run, arch, precision, seconds=1500) for arch in ("cpu", "vulkan"))
    assert cpu["steps"] == 20_000 and cpu["rebuilds"] > 100
    assert gpu == cpu
