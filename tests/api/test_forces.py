"""Forces from device functions: closed forms, parameters, energy budget."""

import math

import numpy as np
import pytest
from api.scenes import beads, flying
from scene_builders import particle_group

import granflow as gf
from granflow.kernel_language import ti

MASS = 2500.0 * math.pi / 6.0 * 0.01**3
OFF = {
    "viscosity": 0.0, "rate": 0.0, "acceleration": [0.0] * 3, "amplitude": [0.0] * 3, "frequency": 0.0,
}  # fmt: skip
"""Parameters without force."""


@ti.func
def stokes_drag(radius, velocity, viscosity):
    return -6.0 * math.pi * viscosity * radius * velocity


def general(position, velocity, radius, mass, time, parameters):
    rates = parameters.acceleration + parameters.amplitude * ti.cos(parameters.frequency * time)
    drag = stokes_drag(radius, velocity, parameters.viscosity)
    return mass * (rates - parameters.rate * velocity) + drag


def force(name="general", **parameters):
    """A force with a constant and an oscillating acceleration, a linear and a viscous resistance."""
    return gf.ParticleForce(general, OFF | parameters, name=name)


def settings(step):
    """Part `run` of a scene with this time step [s]."""
    return {"duration": 1.0, "time_step": step, "velocity_max": 1.0}


def test_stokes_drag_follows_the_exponential_and_is_of_second_order(taichi_f64):
    """Velocity and path of a particle with drag, with the error of the scheme.

        v = v0 exp(-t / tau),   x = x0 + v0 tau (1 - exp(-t / tau)),   tau = m / (6 pi eta R)

    With h = dt / tau a step multiplies the velocity by 1 - h + h^2 / 2: the relative error at t = tau is h^2
    / 6.
    """
    viscosity = 20.0
    tau = MASS / (6.0 * math.pi * viscosity * 0.005)
    kinetic = MASS  # kinetic energy [J] of two particles at 1 m/s
    for step in (2e-5, 1e-5):
        h = step / tau
        with gf.Simulation(flying(run=settings(step)), forces=[force(viscosity=viscosity)]) as simulation:
            simulation.run(until=tau)
            totals = simulation.snapshot().totals
            decayed = math.exp(-simulation.time / tau)
            speed = simulation.particles.velocity[0, 0]
            place = simulation.particles.position[0, 0]
        assert speed / decayed - 1.0 == pytest.approx(h**2 / 6.0, rel=0.1)
        assert place == pytest.approx(tau * (1.0 - decayed), rel=h**2)
        assert totals["external_work"] == pytest.approx(-kinetic * (1.0 - decayed**2), rel=h**2)
        assert abs(totals["energy_error"]) < h**2


def test_force_and_damping_of_the_scene_are_of_second_order_together(taichi_f64):
    """The force F = m (-a e_z - k v) with damping: {drag: g, cundall: c}, which adds -c |F_i| sign(v_i) - m g v_i.

        v_x = exp(-p t),   p = (1 + c) k + g
        v_z = -w,   dw/dt = (1 - c) (a - k w) - g w:   w = W + B exp(-r t),   r = (1 - c) k + g,   W = (1 - c) a / r

    Work of the force: m (a S - k I_z - k I_x); damping: m (c (a S - k I_z) + c k I_x + g (I_x + I_z)), with the
    integrals I of the squares of the velocities, S of w. An extrapolation of the velocity without the damping has
    errors of 1e-3 instead, which halve with the step; so would a particle that is inserted during the run, if only its
    weight shifted its velocity back by half a step.
    """
    a, k, g, c = 20.0, 300.0, 400.0, 0.3
    p, r = (1.0 + c) * k + g, (1.0 - c) * k + g
    limit = (1.0 - c) * a / r
    begin = 0.01 - limit
    start = {"velocity": [1.0, 0.0, -0.01]}
    region = {"box": {"min": [0.0, 0.2, 0.0], "max": [0.02, 0.22, 0.02]}}
    rain = {"kind": "rain", "rate": 1e6, "start": 8e-4, "region": region}
    groups = {"beads": particle_group([[0.0] * 3, [0.0, 0.1, 0.0]], **start)}
    groups["late"] = {"material": "glass", "count": 1, "diameter": 0.01, "insert": rain} | start

    def after(t):
        """Velocity, work of the force and dissipation of the damping of a particle after a time, over its mass."""
        decay, ending = math.exp(-p * t), math.exp(-r * t)
        path = limit * t + begin * (1.0 - ending) / r
        squares_x = (1.0 - decay**2) / (2.0 * p)
        squares_z = limit**2 * t + 2.0 * limit * begin * (1.0 - ending) / r
        squares_z += begin**2 * (1.0 - ending**2) / (2.0 * r)
        work_z = a * path - k * squares_z
        damped = c * work_z + c * k * squares_x + g * (squares_x + squares_z)
        return np.array([decay, 0.0, -limit - begin * ending]), work_z - k * squares_x, damped

    errors = []
    for step in (4e-5, 2e-5):
        damping = {"drag": g, "cundall": c}
        scene = flying(particles=groups, damping=damping, run=settings(step))
        with gf.Simulation(scene, forces=[force(rate=k, acceleration=[0.0, 0.0, -a])]) as simulation:
            simulation.run(until=2e-3)
            t = simulation.time
            velocity = simulation.particles.velocity[np.argsort(simulation.particles.id)]
            totals = simulation.snapshot().totals
        second_order = (p * step) ** 2
        of_each = [after(t), after(t), after(t - rain["start"])]
        np.testing.assert_allclose(velocity, [each[0] for each in of_each], rtol=second_order, atol=1e-12)
        errors.append(velocity[[0, 2], 0] / [of_each[0][0][0], of_each[2][0][0]] - 1.0)
        work, damped = (MASS * sum(each[k] for each in of_each) for k in (1, 2))
        assert totals["damping_dissipation"] == pytest.approx(damped, rel=second_order)
        assert totals["external_work"] == pytest.approx(work, rel=second_order)
        assert abs(totals["energy_error"]) < second_order
    np.testing.assert_allclose(errors[0] / errors[1], 4.0, rtol=0.1)


def test_constant_field_gives_the_parabola_and_new_parameters_act_without_compilation(taichi_f64):
    """Then the field is opposite, and after that a cos(w t) along y:  v_y = (a / w) (sin(w t) - sin(w t0))."""
    field = force(acceleration=(0.0, 0.0, -20.0))
    with gf.Simulation(flying(), forces=[field]) as simulation:
        simulation.run(until=0.01)
        t = simulation.time
        np.testing.assert_allclose(simulation.particles.velocity[0], [1.0, 0.0, -20.0 * t], rtol=1e-9)
        np.testing.assert_allclose(simulation.particles.position[0], [t, 0.0, -10.0 * t**2], rtol=1e-9)
        work = simulation.snapshot().totals["external_work"]
        assert work == pytest.approx(400.0 * t**2 * MASS, rel=1e-9)
        kernels = simulation.engine.state
        field.parameters["acceleration"] = [0.0, 0.0, 20.0]
        simulation.run(duration=0.01)
        later = simulation.time
        assert simulation.engine.state is kernels
        assert simulation.particles.velocity[0, 2] == pytest.approx(20.0 * (later - 2.0 * t), abs=1e-3)
        field.parameters = OFF | {"amplitude": [0.0, 10.0, 0.0], "frequency": 500.0}
        simulation.run(duration=0.01)
        gained = 10.0 / 500.0 * (math.sin(500.0 * simulation.time) - math.sin(500.0 * later))
        assert simulation.particles.velocity[0, 1] == pytest.approx(gained, abs=1e-4)
        assert abs(simulation.snapshot().totals["energy_error"]) < 1e-3


def test_forces_are_added_and_removed_while_the_simulation_runs(taichi_f64):
    """A scene without forces has no arrays for them."""
    up = force(acceleration=(0.0, 0.0, 5.0))
    down = force("down", acceleration=(0.0, 0.0, -15.0))
    with gf.Simulation(flying()) as simulation:
        state = simulation.engine.state
        assert state.particles.external_force is None and "external_work" not in simulation.snapshot().totals
        simulation.run(until=1e-3)
        start = simulation.time
        simulation.forces.append(up)
        simulation.forces.append(down)
        np.testing.assert_allclose(simulation.particles.force[0], [0.0, 0.0, -10.0 * MASS])
        simulation.run(until=3e-3)
        both = simulation.time
        assert simulation.particles.velocity[0, 2] == pytest.approx(-10.0 * (both - start), rel=1e-9)
        simulation.forces.remove(down)
        simulation.run(until=5e-3)
        expected = -10.0 * (both - start) + 5.0 * (simulation.time - both)
        assert simulation.particles.velocity[0, 2] == pytest.approx(expected, rel=1e-9)
        assert abs(simulation.snapshot().totals["energy_error"]) < 1e-9
        assert [force.name for force in simulation.forces] == ["general"]


def test_budget_closes_with_contacts_and_neighbor_list_rebuilds(taichi_f64):
    """Particles bounce on a floor under drag and a field; more than one chunk and many rebuilds."""
    positions = 0.011 * np.argwhere(np.ones((5, 5, 5))) + [0.0, 0.0, 0.01]
    groups = {"beads": particle_group(positions, velocity=[0.3, 0.2, -1.0])}
    scene = beads(groups=groups, gravity=[0.0] * 3, pair={"friction": 0.3}, numerics={"chunk_size": 16})
    with gf.Simulation(scene, forces=[force(viscosity=1.0, acceleration=[0.0, 0.0, -30.0])]) as simulation:
        simulation.run(until=0.02)
        totals = simulation.snapshot().totals
        assert totals["friction_dissipation"] > 0.0 and simulation.engine.timing.rebuild_count > 5
        assert abs(totals["energy_error"]) < 1e-3


def invalid(position, velocity, radius, mass, time, parameters):
    return parameters.acceleration * ti.sqrt(parameters.limit - position[0])


def test_the_message_of_an_abort_names_the_force(taichi_f64):
    """The square root is not a number beyond the limit."""
    wrong = gf.ParticleForce(invalid, {"limit": 1e-3, "acceleration": [1.0, 0.0, 0.0]})
    with gf.Simulation(flying(), forces=[wrong]) as simulation, pytest.raises(gf.RunError) as stopped:
        simulation.run()
    message = str(stopped.value)
    assert "is not a number. It has no contacts" in message
    assert message.endswith("The force from Python may also be the cause: check the values of invalid.")
