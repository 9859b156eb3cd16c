"""What a scene does not need is left out without a change of the bits of the rest."""

import numpy as np
import pytest
from scene_builders import box, build_scene, particle_group, plane, run_to_end

WALLS = box(0.05) | {"far": plane([0, 0, -0.5], [0, 0, 1], "steel")}


def bed(walls=WALLS, **changes):
    """A block of particles that overlap initially and then separate."""
    rng = np.random.default_rng(6)
    positions = 0.0098 * (np.argwhere(np.ones((4, 4, 4))) + 0.8)
    group = particle_group(positions, 0.01, velocity=rng.normal(0.0, 0.3, positions.shape))
    parts = {"pair": {"friction": 0.4}} | changes
    return build_scene(
        {"balls": group}, walls=walls, gravity=[0.0, 0.0, -9.81], run={"duration": 0.003, "velocity_max": 2.0}, **parts,
    )  # fmt: skip


def test_friction_coefficient_0_is_bit_identical_to_disabled_friction(taichi_f64):
    """A rough wall out of reach enables friction; all pairs in contact have the coefficient 0."""
    smooth = {"friction": 0.0}
    without, plain = run_to_end(bed(pair=smooth))
    idle, rough = run_to_end(bed(pair=smooth, pairs={"glass-steel": {"restitution": 0.8, "friction": 0.5}}))
    assert plain.plan.laws.names["tangential"] == "none"
    assert rough.plan.laws.names["tangential"] == "mindlin"
    assert np.all(np.abs(without.particles["velocity"]).max(axis=1) > 0.1), "all particles move"
    for name in ("position", "velocity", "force"):
        np.testing.assert_array_equal(idle.particles[name], without.particles[name])
    assert not idle.particles["angular_velocity"].any()


@pytest.mark.slow
def test_wear_does_not_change_the_motion(taichi_f64):
    """Also without friction and rotation, which kernels compile differently."""
    wear = {"law": "finnie", "coefficient": 0.1, "hardness": "1 GPa"}
    for friction in (0.4, 0.0):
        without, _ = run_to_end(bed(pair={"friction": friction}))
        worn, _ = run_to_end(
            bed({name: wall | {"wear": wear} for name, wall in WALLS.items()}, pair={"friction": friction})
        )
        assert worn.totals["wear_volume.low_z"] > 0.0
        for name in ("position", "velocity", "angular_velocity", "force"):
            np.testing.assert_array_equal(worn.particles[name], without.particles[name])
