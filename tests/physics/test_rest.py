"""Zhou contacts at rest: damping of contacts that reload brings particles to rest, and their displacement
ends."""

import numpy as np
from scene_builders import column, few_spheres, particle_group, plane, run_and_sample, times

DIAMETER = 0.01
SOLID = {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": 2500.0}
FLOOR = {"floor": plane([0, 0, 0], [0, 0, 1])}
STORED = tuple(f"{name}_energy" for name in ("kinetic", "rotational", "gravitational", "elastic"))
DISSIPATED = tuple(f"{name}_dissipation" for name in ("plastic", "friction", "rolling", "damping"))


def at_rest(group, duration, interval, restitution, walls=FLOOR, **numerics):
    """Snapshots of particles under gravity above a floor."""
    scene = few_spheres(
        {"balls": group}, walls, {"restitution": restitution, "friction": 0.5}, materials={"glass": SOLID},
        gravity=[0.0, 0.0, -9.81], numerics=numerics,
        run={"duration": duration, "velocity_max": 1.0},
    )  # fmt: skip
    return run_and_sample(scene, interval)


def stack(restitution, duration):
    """Snapshots of three particles that fall by 1 mm, one on another."""
    centers = [[0.0, 0.0, DIAMETER * (0.5 + number) + 0.001 * (1 + number)] for number in range(3)]
    return at_rest(particle_group(centers, DIAMETER), duration, 0.1, restitution, time_step_fraction=0.1)


def test_stack_comes_to_rest_to_rounding(taichi_f64):
    """The error of the loss by rest damping is of first order in the time step. With the restitution 1 nothing
    damps, and plastic work remains at the rounding of the energies."""
    first, *_, before, last = stack(0.3, 0.6)
    assert last.totals["kinetic_energy"] < 1e-24
    np.testing.assert_allclose(last.particles["position"], before.particles["position"], rtol=0.0, atol=1e-15)
    change = [sum(each.totals[name] for name in (*STORED, *DISSIPATED)) for each in (first, last)]
    assert abs(change[1] - change[0]) < 2e-3 * sum(last.totals[name] for name in DISSIPATED)
    elastic = stack(1.0, 0.3)[-1].totals
    assert elastic["damping_dissipation"] == 0.0
    assert sum(elastic[name] for name in DISSIPATED) < 1e-12 * elastic["gravitational_energy"]


def test_particle_rolls_around_a_vertical_cylinder_without_falling(taichi_f64):
    """Rest damping is neither friction nor adhesion: a sphere that rolls around a cylinder keeps its energy.

    With v = a w x n (no slip), the center at the distance b from the axis with the angular velocity W, and
    spin zero:

        (1 + K) z'' = -g - K W^2 (z - z0)      =>      z = z0 - g / (K W^2) (1 - cos(sqrt(K / (1 + K)) W t))

    with K = I / (m a^2) and the distance a = R - d/2 from the center to the contact point (the golfer's
    dilemma; K = 2/5 for a rigid sphere).
    """
    radius, path, rate = DIAMETER / 2, 0.045, 40.0
    mass = SOLID["density"] * np.pi * DIAMETER**3 / 6
    modulus = SOLID["young_modulus"] / (2 * (1 - 0.25**2))
    # overlap of the centripetal force
    overlap = (mass * path * rate**2 / (4 / 3 * modulus * np.sqrt(radius))) ** (2 / 3)
    arm = radius - 0.5 * overlap
    sphere = particle_group([path, 0.0, 0.05], DIAMETER, velocity=[0.0, path * rate, 0.0],
                            angular_velocity=[0.0, 0.0, -path * rate / arm])  # fmt: skip
    shell = {"shape": "cylinder", "from": [0, 0, -0.1], "to": [0, 0, 0.1], "material": "glass",
             "radius": path + radius - overlap}  # fmt: skip
    snapshots = at_rest(sphere, 0.3, 0.02, 0.5, {"shell": shell})
    inertia = 0.4 * (radius / arm) ** 2
    fall = 9.81 / (inertia * rate**2)
    angular_frequency = np.sqrt(inertia / (1 + inertia)) * rate
    expected = 0.05 - fall * (1 - np.cos(angular_frequency * times(snapshots)))
    np.testing.assert_allclose(column(snapshots, "position")[:, 0, 2], expected, atol=0.005 * fall)
    lost = sum(snapshots[-1].totals[f"{name}_dissipation"] for name in ("friction", "damping"))
    assert lost < 1e-4 * 0.5 * mass * (path * rate) ** 2
