"""Zhou contacts at rest: damping of contacts that reload brings particles to rest, and their displacement ends."""

import numpy as np
from scene_builders import build_scene, column, particle_group, plane, run_and_sample

DIAMETER = 0.01
SOLID = {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": 2500.0}
DAMPED = {"law": "zhou", "rest_damping": 0.1}
FLOOR = {"floor": plane([0, 0, 0], [0, 0, 1])}
STORED = tuple(f"{name}_energy" for name in ("kinetic", "rotational", "gravitational", "elastic"))
DISSIPATED = tuple(f"{name}_dissipation" for name in ("plastic", "friction", "rolling", "damping"))


def scene_at_rest(groups, duration, normal, restitution, **parts):
    """Particles under gravity above a floor, with an energy budget."""
    usual = {
        "gravity": [0.0, 0.0, -9.81],
        "domain": {"min": [-0.3] * 3, "max": [0.3] * 3, "on_exit": "delete"},
        "numerics": {"time_step_fraction": 0.2},
        "pair": {"restitution": restitution, "friction": 0.5},
    }
    run, output = {"duration": duration, "velocity_max": 1.0}, {"interval": 1.0, "energy_budget": True}
    return build_scene(
        groups, walls=FLOOR, normal=normal, materials={"glass": SOLID}, run=run, output=output, **(usual | parts)
    )


def stack(normal, restitution, duration):
    """Snapshots of three particles that fall by 1 mm, one on another."""
    centers = [[0.0, 0.0, DIAMETER * (0.5 + number) + 0.001 * (1 + number)] for number in range(3)]
    scene = scene_at_rest({"stack": particle_group(centers, DIAMETER)}, duration, normal, restitution)
    return run_and_sample(scene, 0.1)


def kinetic(snapshots):
    """Kinetic energies of the translation [J]."""
    return np.array([snapshot.totals["kinetic_energy"] for snapshot in snapshots])


def residual(snapshots):
    """Relative residual of the energy budget at the end."""
    first, last = snapshots[0].totals, snapshots[-1].totals
    total = sum(last[name] for name in (*STORED, *DISSIPATED)) - sum(first[name] for name in (*STORED, *DISSIPATED))
    return total / sum(last[name] for name in DISSIPATED)


def test_stack_comes_to_rest_to_rounding(taichi_f64):
    """Without rest damping, contacts reload elastically and the oscillation about the equilibrium remains."""
    damped, undamped = stack(DAMPED, 0.3, 0.6), stack("zhou", 0.3, 0.6)
    assert kinetic(damped)[-1] < 1e-24
    assert kinetic(undamped)[-1] > 1e-9
    assert abs(residual(damped)) < 2e-3
    assert np.ptp(column(damped[-2:], "position"), axis=0).max() < 1e-15


def test_restitution_1_remains_without_dissipation(taichi_f64):
    """Rest damping does not act on pairs of the restitution 1; plastic work remains at the rounding of the energies."""
    last = stack(DAMPED, 1.0, 0.3)[-1].totals
    assert last["damping_dissipation"] == 0.0
    assert sum(last[name] for name in DISSIPATED) < 1e-12 * last["gravitational_energy"]
