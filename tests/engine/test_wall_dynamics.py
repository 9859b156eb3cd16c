"""Force-controlled walls: a free piston against its equation of motion, and a servo wall that holds a
pressure."""

import re

import numpy as np
import pytest
from scene_builders import SOFT, box, build_scene, column, particle_group, plane, run_and_sample, times
from scipy.integrate import solve_ivp

from granflow.contact import theory
from granflow.errors import RunError, SceneError
from granflow.plan.build import plan_for
from granflow.simulation import Simulation

RADIUS, GRAVITY = 0.005, 9.81
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * 2500.0
MODULUS = SOFT["young_modulus"] / (2.0 * (1.0 - SOFT["poisson_ratio"] ** 2))
AT_WALL = theory.hertz_stiffness(MODULUS, RADIUS)
FLOOR = plane([0, 0, 0], [0, 0, 1])


def lid(height, motion, size=0.04):
    return {
        "shape": "rectangle", "corner": [-size / 2, -size / 2, height], "sides": [[size, 0, 0], [0, size, 0]],
        "material": "glass", "motion": motion,
    }  # fmt: skip


def free(mass, **more):
    return {"kind": "free", "direction": [0, 0, 1], "mass": mass} | more


AWAY = {"kind": "servo", "direction": [0, 0, 1], "force": 1.0, "velocity_max": 1e-3}
"""A servo wall that moves away from all particles."""


def balls_below(servo=None, piston=None, positions=((0.0, 0.0, RADIUS),), **parts):
    """Balls on a floor below a servo wall and a free wall; both are far away unless given.

    All scenes have one compiled structure, that of `compression_scene`: the far wall meets the
    floor, and its pair has dashpots and friction, which the contacts here need not have.
    """
    walls = {
        "floor": FLOOR, "lid": servo or lid(0.5, AWAY), "piston": piston or lid(0.6, free(1.0)),
        "far": plane([-0.9, 0, 0], [1, 0, 0], "steel"),
    }  # fmt: skip
    pairs = {"glass-steel": {"restitution": 0.5, "friction": 0.3}}
    run = {"duration": 0.03, "velocity_max": 0.3}
    output = {"interval": 1.0, "energy_budget": True, "wall_forces": True}
    defaults = {"run": run, "output": output, "gravity": [0.0, 0.0, -GRAVITY], "pair": {"restitution": 1.0}}
    numerics = {"chunk_size": 16} | parts.pop("numerics", {})
    return build_scene(
        {"balls": particle_group(positions)},
        walls,
        normal="hertz",
        pairs=pairs,
        numerics=numerics,
        **(defaults | parts),
    )


def test_free_piston_bounces_on_a_particle(taichi_f64):
    """A particle touches the floor without overlap; the piston starts 1 mm above it: two masses on two Hertz contacts, compared with scipy; work and energy of the piston balance.

    M x'' = k (R - x + z)^1.5 - M g + F - c x',    m z'' = k (R - z)^1.5 - k (R - x + z)^1.5 - m g
    """
    mass, force, damping = 0.01, 0.02, 0.5
    piston = lid(2.0 * RADIUS + 1e-3, free(mass, force=force, damping=damping))
    snapshots = run_and_sample(balls_below(piston=piston, numerics={"time_step_fraction": 0.01}), 0.0005)

    def rates(_, now):
        z, x, w, v = now
        below, above = (AT_WALL * max(RADIUS - gap, 0.0) ** 1.5 for gap in (z, x - z))
        return [w, v, (below - above) / MASS - GRAVITY, (above + force - damping * v) / mass - GRAVITY]

    start = [RADIUS, 2.0 * RADIUS + 1e-3, 0.0, 0.0]
    exact = solve_ivp(
        rates, (0.0, 0.031), start, t_eval=times(snapshots), rtol=1e-10, atol=1e-14, max_step=2e-5
    ).y
    piston_height = np.array([each.walls["piston"].offset[2] for each in snapshots]) + 2.0 * RADIUS + 1e-3
    piston_velocity = np.array([each.totals["wall_velocity.piston"] for each in snapshots])
    assert exact[1].min() < 2.0 * RADIUS - 1e-5 and np.diff(np.sign(exact[3])).any(), (
        "the piston hits the particle and rebounds"
    )
    np.testing.assert_allclose(piston_height, exact[1], rtol=0.0, atol=5e-8)
    np.testing.assert_allclose(piston_velocity, exact[3], rtol=0.0, atol=2e-5)
    np.testing.assert_allclose(column(snapshots, "position")[:, 0, 2], exact[0], rtol=0.0, atol=5e-7)
    last = snapshots[-1].totals
    assert last["free_wall_energy"] == pytest.approx(0.5 * mass * piston_velocity[-1] ** 2)
    work_done = last["free_wall_work"] - last["wall_work"]
    assert work_done == pytest.approx(last["free_wall_energy"], rel=1e-9, abs=1e-14)
    assert snapshots[-1].impulses["piston"][7] == last["wall_work"], "the piston alone moves against a force"
    assert abs(last["energy_error"]) < 1e-3


PRESSURE, SIDE = 2e4, 0.041


def compression_scene(duration=0.03, **parts):
    """A loose lattice in a box, with a servo wall as lid and a free wall as one side."""
    walls = {name: wall for name, wall in box(SIDE).items() if name not in ("high_z", "high_x")}
    servo = {"kind": "servo", "direction": [0, 0, -1], "pressure": PRESSURE, "velocity_max": 0.5}
    walls["lid"] = {
        "shape": "rectangle", "corner": [0, 0, SIDE], "sides": [[SIDE, 0, 0], [0, SIDE, 0]], "material": "glass",
        "motion": servo,
    }  # fmt: skip
    weight = {"kind": "free", "direction": [-1, 0, 0], "mass": 0.05, "force": 10.0, "damping": 30.0}
    walls["side"] = {
        "shape": "rectangle", "corner": [SIDE, 0, 0], "sides": [[0, SIDE, 0], [0, 0, SIDE]], "material": "glass",
        "motion": weight,
    }  # fmt: skip
    positions = 0.0102 * (np.argwhere(np.ones((4, 4, 4))) + 0.5)
    defaults = {
        "pair": {"friction": 0.3, "restitution": 0.3}, "numerics": {"chunk_size": 16},
        "run": {"velocity_max": 1.0},
        "output": {"interval": duration, "timeseries_interval": duration / 30.0, "wall_forces": True,
                   "energy_budget": True},
        "stages": [{"name": "press", "duration": 0.8 * duration}, {"name": "hold", "duration": 0.2 * duration}],
    }  # fmt: skip
    return build_scene(
        {"balls": particle_group(positions)}, walls=walls, normal="hertz", **(defaults | parts)
    )


def test_servo_wall_holds_its_pressure_and_free_wall_its_force(taichi_f64):
    with Simulation(compression_scene(), threads=2) as simulation:
        result = simulation.run().numbers
    assert result["wall_pressure.lid"] == pytest.approx(PRESSURE, rel=0.01)
    assert result["wall_force_x.side"] == pytest.approx(10.0, rel=0.01)


SERVO = {"kind": "servo", "direction": [0, 0, -1], "force": 1.6, "velocity_max": 0.2}


def loaded_ball(restitution, fraction, normal="hertz", **walls):
    """A ball between the floor and a lid that presses it with 1.6 N."""
    walls = walls or {"servo": lid(2.02 * RADIUS, SERVO)}
    return balls_below(
        **walls, pair={"restitution": restitution}, contact={"normal": normal, "tangential": "mindlin", "rolling": "none"},
        gravity=[0.0] * 3, run={"duration": 0.1, "velocity_max": 0.3}, numerics={"time_step_fraction": fraction},
    )  # fmt: skip


def largest_response(plan):
    """Largest stiffness [N/m] and viscosity [N s/m] of the contacts of a plan."""
    step = plan.impact_velocity.value, plan.time_step
    responses = [
        plan.laws.normal.present_response(*case.dashpot_arguments, *step) for case in plan.pair_cases
    ]
    return np.max(responses, axis=0)


def test_servo_comes_to_rest_on_a_contact_with_a_dashpot(taichi_f64):
    """Force 1.6 N at an elastic contact: F = k d^1.5."""
    with Simulation(loaded_ball(0.1, 0.03)) as simulation:
        simulation.run()
        last = simulation.snapshot(contacts=True)
    assert abs(last.totals["wall_velocity.lid"]) < 1e-9
    assert last.contacts["normal_force"] == pytest.approx(1.6, rel=1e-6)
    assert last.contacts["overlap"].max() == pytest.approx((1.6 / AT_WALL) ** (2.0 / 3.0), rel=1e-6)


@pytest.mark.parametrize(
    ("normal", "restitution", "fraction"), [("hertz", 0.05, 0.05), ("hertz", 0.9, 0.05), ("zhou", 0.0, 0.05)]
)
def test_lag_of_a_servo_makes_it_stable_on_all_contacts_of_the_layer(normal, restitution, fraction):
    """Roots of the recursion of its displacement on n contacts of stiffness K and viscosity C.

    x'' = x' + dt v',   v' = v + (gain (-K x' - C v) - v) / (1 + lag):  z^2 - (1 + p - b) z + p = 0
    """
    plan = plan_for(loaded_ball(restitution, fraction, normal))
    motion, step = plan.controlled_motions[0], plan.time_step
    gain, lag = motion.numbers["gain"], motion.numbers["lag"]
    largest_stiffness, largest_viscosity = largest_response(plan)
    for stiffness in np.linspace(0.01, 1.0, 20) * largest_stiffness:
        for viscosity in np.linspace(0.0, 1.0, 20) * largest_viscosity:
            p = (lag - gain * viscosity) / (1.0 + lag)
            b = gain * stiffness * step / (1.0 + lag)
            assert np.abs(np.roots([1.0, -(1.0 + p - b), p])).max() < 1.0


def test_least_mass_of_a_free_wall_is_twice_that_of_stability_on_dashpots():
    """z^2 - (2 - a - b) z + 1 - a = 0 with a = C dt/M, b = K dt^2/M for a wall of mass M; stable for 2 a + b
    < 4."""
    message = r"walls.piston.motion.mass is 1e-09 kg, but .* oscillates too fast"
    with pytest.raises(SceneError, match=message) as refused:
        plan_for(loaded_ball(0.1, 0.05, piston=lid(2.02 * RADIUS, free(1e-9))))
    mass = float(re.search(r"set it to (\S+) kg", str(refused.value))[1])
    plan = plan_for(loaded_ball(0.1, 0.05, piston=lid(2.02 * RADIUS, free(1.1 * mass))))
    stiffness, viscosity = largest_response(plan)
    a, b = viscosity * plan.time_step / mass, stiffness * plan.time_step**2 / mass
    assert 2.0 * a + b == pytest.approx(2.0, rel=0.05), "printed with two digits"


def test_free_wall_too_fast_for_the_step_aborts_the_run(taichi_f64):
    """A force F moves a wall of mass M from rest by F/M dt^2 (k - 1/2) in step k; the limit is 0.2 R."""
    step, steps = 1e-5, 40
    run = {"duration": 1.0, "velocity_max": 1.0, "time_step": step}
    for share in (0.999, 1.001):
        piston = lid(0.5, free(1.0, force=share * 0.2 * RADIUS / (step**2 * (steps - 0.5))))
        scene = balls_below(piston=piston, run=run, gravity=[0.0] * 3, numerics={"skin": 0.003})
        with Simulation(scene) as simulation:
            if share > 1.0:
                message = (
                    r"piston \(glass, 100 m/s\) .* moves 0.001 m in .* limit .* Increase its mass or damping"
                )
                with pytest.raises(RunError, match=message):
                    simulation.run(until=steps * step)
            else:
                simulation.run(until=steps * step)


def test_servo_gain_unstable_for_the_step_is_rejected():
    motion = {"kind": "servo", "direction": [0, 0, -1], "force": 1.0, "velocity_max": 0.1, "gain": 1e3}
    with pytest.raises(
        SceneError, match=r"walls.piston.motion.gain is 1e\+03 m/\(s N\), but from .* on the wall"
    ):
        plan_for(build_scene({"ball": particle_group([[0, 0, RADIUS]])}, walls={"piston": lid(0.02, motion)}))
