"""Zhou contacts at rest: damping of contacts that reload brings particles to rest, and their displacement
ends."""

import numpy as np
from scene_builders import build_scene, column, particle_group, plane, run_and_sample, times

DIAMETER = 0.01
SOLID = {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": 2500.0}
UNDAMPED = {"law": "zhou", "rest_damping": 0.0}
FLOOR = {"floor": plane([0, 0, 0], [0, 0, 1])}
STORED = tuple(f"{name}_energy" for name in ("kinetic", "rotational", "gravitational", "elastic"))
DISSIPATED = tuple(f"{name}_dissipation" for name in ("plastic", "friction", "rolling", "damping"))


def scene_at_rest(groups, duration, normal, restitution, **parts):
    """Particles under gravity above a floor, with an energy budget."""
    usual = {
        "walls": FLOOR,
        "gravity": [0.0, 0.0, -9.81],
        "domain": {"min": [-0.3] * 3, "max": [0.3] * 3, "on_exit": "delete"},
        "numerics": {"time_step_fraction": 0.2},
        "pair": {"restitution": restitution, "friction": 0.5},
    }
    run = {"duration": duration, "velocity_max": 1.0}
    output = {"interval": 1.0, "energy_budget": True}
    return build_scene(
        groups, normal=normal, materials={"glass": SOLID}, run=run, output=output, **(usual | parts)
    )


def stack(normal, restitution, duration):
    """Snapshots of three particles that fall by 1 mm, one on another."""
    centers = [[0.0, 0.0, DIAMETER * (0.5 + number) + 0.001 * (1 + number)] for number in range(3)]
    numerics = {
        "time_step_fraction": 0.1
    }  # the error of the loss by rest damping is of first order in the time step
    scene = scene_at_rest(
        {"stack": particle_group(centers, DIAMETER)}, duration, normal, restitution, numerics=numerics
    )
    return run_and_sample(scene, 0.1)


def kinetic(snapshots):
    """Kinetic energies of the translation [J]."""
    return np.array([snapshot.totals["kinetic_energy"] for snapshot in snapshots])


def residual(snapshots):
    """Relative residual of the energy budget at the end."""
    first, last = snapshots[0].totals, snapshots[-1].totals
    total = sum(last[name] for name in (*STORED, *DISSIPATED)) - sum(
        first[name] for name in (*STORED, *DISSIPATED)
    )
    return total / sum(last[name] for name in DISSIPATED)


def test_stack_comes_to_rest_to_rounding(taichi_f64):
    """Without rest damping, contacts reload elastically and the oscillation about the equilibrium remains."""
    damped = stack("zhou", 0.3, 0.6)
    undamped = stack(UNDAMPED, 0.3, 0.6)
    assert kinetic(damped)[-1] < 1e-24
    assert kinetic(undamped)[-1] > 1e-9
    assert abs(residual(damped)) < 2e-3
    assert np.ptp(column(damped[-2:], "position"), axis=0).max() < 1e-15


def test_restitution_1_remains_without_dissipation(taichi_f64):
    """Rest damping does not act on pairs of the restitution 1; plastic work remains at the rounding of the
    energies."""
    last = stack("zhou", 1.0, 0.3)[-1].totals
    assert last["damping_dissipation"] == 0.0
    assert sum(last[name] for name in DISSIPATED) < 1e-12 * last["gravitational_energy"]


def test_particle_rolls_around_a_vertical_cylinder_without_falling(taichi_f64):
    """Rest damping is neither friction nor adhesion: a sphere that rolls around a cylinder keeps its energy.

    With v = a w x n (no slip), the center at the distance b from the axis with the angular velocity W, and
    spin zero:

        (1 + K) z'' = -g - K W^2 (z - z0)      =>      z = z0 - g / (K W^2) (1 - cos(sqrt(K / (1 + K)) W t))

    with K = I / (m a^2) and the distance a = R - d/2 from the center to the contact point (the golfer's
    dilemma; K = 2/5 for a rigid sphere).
    """
    radius = DIAMETER / 2
    path = 0.045
    rate = 40.0
    mass = SOLID["density"] * np.pi * DIAMETER**3 / 6
    modulus = SOLID["young_modulus"] / (2 * (1 - 0.25**2))
    overlap = (mass * path * rate**2 / (4 / 3 * modulus * np.sqrt(radius))) ** (
        2 / 3
    )  # of the centripetal force
    shell = {"shape": "cylinder", "from": [0, 0, -0.1], "to": [0, 0, 0.1], "material": "glass"}
    sphere = particle_group(
        [[path, 0.0, 0.05]],
        DIAMETER,
        velocity=[0.0, path * rate, 0.0],
        angular_velocity=[0.0, 0.0, -path * rate / (radius - 0.5 * overlap)],
    )
    walls = {"shell": shell | {"radius": path + radius - overlap}}
    scene = scene_at_rest({"sphere": sphere}, 0.3, "zhou", 0.5, walls=walls, numerics={})
    snapshots = run_and_sample(scene, 0.02)
    heights = np.array([snapshot.particles["position"][0, 2] for snapshot in snapshots])
    inertia = 0.4 * (radius / (radius - 0.5 * overlap)) ** 2
    fall = 9.81 / (inertia * rate**2)
    angular_frequency = np.sqrt(inertia / (1 + inertia)) * rate
    expected = 0.05 - fall * (1 - np.cos(angular_frequency * times(snapshots)))
    np.testing.assert_allclose(heights, expected, atol=0.005 * fall)
    lost = sum(snapshots[-1].totals[f"{name}_dissipation"] for name in ("friction", "damping"))
    assert lost < 1e-4 * 0.5 * mass * (path * rate) ** 2
