"""What a scene does not need is left out without a change of the bits of the rest."""

import numpy as np
from scene_builders import box, build_scene, particle_group, plane, run_to_end


def bed(**parts):
    """A block of particles without friction that overlap initially and then separate."""
    rng = np.random.default_rng(6)
    positions = 0.0098 * (np.argwhere(np.ones((4, 4, 4))) + 0.8)
    group = particle_group(positions, 0.01, velocity=rng.normal(0.0, 0.3, positions.shape))
    return build_scene(
        {"balls": group}, walls=box(0.05) | {"far": plane([0, 0, -0.5], [0, 0, 1], "steel")},
        gravity=[0.0, 0.0, -9.81], run={"duration": 0.003, "velocity_max": 2.0}, **parts,
    )  # fmt: skip


def test_friction_coefficient_0_is_bit_identical_to_disabled_friction(taichi_f64):
    """A rough wall out of reach enables friction; all pairs in contact have the coefficient 0."""
    without, plain = run_to_end(bed())
    idle, rough = run_to_end(bed(pairs={"glass-steel": {"restitution": 0.8, "friction": 0.5}}))
    assert plain.plan.laws.names["tangential"] == "none"
    assert rough.plan.laws.names["tangential"] == "mindlin"
    assert np.all(np.abs(without.particles["velocity"]).max(axis=1) > 0.1), "all particles move"
    for name in ("position", "velocity", "force"):
        np.testing.assert_array_equal(idle.particles[name], without.particles[name])
    assert not idle.particles["angular_velocity"].any()
