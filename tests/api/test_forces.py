"""Forces from device functions: closed forms, parameters, energy budget."""

import math

import numpy as np
import pytest
import taichi as ti
from scene_builders import build_scene, particle_group, plane

import granflow as gf

MASS = 2500.0 * math.pi / 6.0 * 0.01**3
VISCOSITY = 20.0


@ti.func
def stokes_drag(position, velocity, radius, mass, time, parameters):
    return -6.0 * math.pi * parameters.viscosity * radius * velocity


def field(position, velocity, radius, mass, time, parameters):
    return mass * parameters.acceleration


def oscillating(position, velocity, radius, mass, time, parameters):
    return mass * parameters.amplitude * cosine(parameters.frequency * time) * parameters.direction


@ti.func
def cosine(angle):
    return ti.cos(angle)


def flying(**more):
    """Two particles that fly without gravity."""
    groups = {"balls": particle_group([[0.0] * 3, [0.0, 0.1, 0.0]], velocity=[1.0, 0.0, 0.0])}
    return build_scene(groups, **{"output": {"interval": 1.0, "energy_budget": True}} | more)


def test_stokes_drag_follows_the_exponential_and_is_of_second_order(taichi_f64):
    """Velocity and path of a particle with drag, with the error of the scheme.

        v = v0 exp(-t / tau),   x = x0 + v0 tau (1 - exp(-t / tau)),   tau = m / (6 pi eta R)

    With h = dt / tau a step multiplies the velocity by 1 - h + h^2 / 2: the relative error at t = tau is h^2
    / 6.
    """
    tau = MASS / (6.0 * math.pi * VISCOSITY * 0.005)
    kinetic = MASS  # kinetic energy [J] of two particles at 1 m/s
    for step in (2e-5, 1e-5):
        h = step / tau
        scene = flying(run={"duration": 1.0, "time_step": step, "velocity_max": 1.0})
        force = gf.ParticleForce(stokes_drag, parameters={"viscosity": VISCOSITY})
        with gf.Simulation(scene, forces=[force]) as simulation:
            simulation.run(until=tau)
            totals = simulation.snapshot().totals
            time = simulation.time
            speed = simulation.particles.velocity[0, 0]
            place = simulation.particles.position[0, 0]
        decayed = math.exp(-time / tau)
        assert speed / decayed - 1.0 == pytest.approx(h**2 / 6.0, rel=0.1)
        assert place == pytest.approx(tau * (1.0 - decayed), rel=h**2)
        assert totals["external_work"] == pytest.approx(-kinetic * (1.0 - decayed**2), rel=h**2)
        assert abs(totals["energy_error"]) < h**2


def resistance(position, velocity, radius, mass, time, parameters):
    return mass * (parameters.acceleration - parameters.rate * velocity)


def damped_motion(damping, step):
    """Time [s], velocity (3,) and totals of a particle with the force m (a - k v) and damping; step [s]."""
    scene = flying(damping=damping, run={"duration": 1.0, "time_step": step, "velocity_max": 1.0})
    force = gf.ParticleForce(resistance, {"rate": 300.0, "acceleration": [0.0, 0.0, -20.0]})
    with gf.Simulation(scene, forces=[force]) as simulation:
        simulation.run(until=2e-3)
        return simulation.time, simulation.particles.velocity[0], simulation.snapshot().totals


def test_force_and_drag_of_the_scene_are_of_second_order_together(taichi_f64):
    """dv/dt = a - (k + g) v with the force m (a - k v) and damping: {drag: g}. With r = k + g:

        v_x = exp(-r t),   v_z = (a / r) (1 - exp(-r t))
        damping D = m g I,   I = integral of v^2,   work of the force W = m a z - m k I

    An extrapolation of the velocity without the drag has errors of 1e-3 instead, which halve with the step.
    """
    drag = 400.0
    rate = 300.0
    field_strength = -20.0
    errors = []
    r = drag + rate
    for step in (4e-5, 2e-5):
        time, velocity, totals = damped_motion({"drag": drag}, step)
        decay = math.exp(-r * time)
        limit = field_strength / r
        errors.append(velocity[0] / decay - 1.0)
        second_order = (r * step) ** 2
        np.testing.assert_allclose(
            velocity, [decay, 0.0, limit * (1.0 - decay)], rtol=second_order, atol=1e-12
        )
        fallen = limit * (time - (1.0 - decay) / r)
        squares = (1.0 - decay**2) / (2.0 * r)
        squares += limit**2 * (time - 2.0 * (1.0 - decay) / r + (1.0 - decay**2) / (2.0 * r))
        mass = 2.0 * MASS  # two particles
        assert totals["damping_dissipation"] == pytest.approx(mass * drag * squares, rel=second_order)
        work = mass * (field_strength * fallen - rate * squares)
        assert totals["external_work"] == pytest.approx(work, rel=second_order)
        assert abs(totals["energy_error"]) < second_order
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_cundall_damping_increases_the_resistance_of_a_force(taichi_f64):
    """The damping a |F| opposes the velocity, as the force -m k v does:   v_x = exp(-(1 + a) k t)."""
    errors = []
    for step in (4e-5, 2e-5):
        time, velocity, _ = damped_motion({"cundall": 0.3}, step)
        errors.append(velocity[0] / math.exp(-1.3 * 300.0 * time) - 1.0)
        assert abs(errors[-1]) < (1.3 * 300.0 * step) ** 2
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_constant_field_gives_the_parabola_and_its_parameter_changes_without_compilation(taichi_f64):
    force = gf.ParticleForce(field, parameters={"acceleration": (0.0, 0.0, -20.0)})
    with gf.Simulation(flying()) as simulation:
        simulation.forces.append(force)
        simulation.run(until=0.01)
        time = simulation.time
        np.testing.assert_allclose(simulation.particles.velocity[0], [1.0, 0.0, -20.0 * time], rtol=1e-9)
        np.testing.assert_allclose(simulation.particles.position[0], [time, 0.0, -10.0 * time**2], rtol=1e-9)
        assert simulation.snapshot().totals["external_work"] == pytest.approx(
            400.0 * time**2 * MASS, rel=1e-9
        )
        kernels = simulation.engine.state
        force.parameters["acceleration"] = [0.0, 0.0, 20.0]
        simulation.run(duration=0.01)
        later = simulation.time - time
        assert simulation.engine.state is kernels
        assert simulation.particles.velocity[0, 2] == pytest.approx(20.0 * (later - time), abs=1e-3)
        assert abs(simulation.snapshot().totals["energy_error"]) < 1e-3


def test_forces_are_added_and_removed_while_the_simulation_runs(taichi_f64):
    up, down = (
        gf.ParticleForce(field, {"acceleration": (0.0, 0.0, each)}, name=name)
        for name, each in (("up", 5.0), ("down", -15.0))
    )
    with gf.Simulation(flying()) as simulation:
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
        assert [force.name for force in simulation.forces] == ["up"]


def test_a_force_receives_the_simulated_time(taichi_f64):
    """dv/dt = a cos(w t):   v = (a / w) sin(w t)."""
    parameters = {"amplitude": 10.0, "frequency": 500.0, "direction": [0.0, 1.0, 0.0]}
    with gf.Simulation(flying(), forces=[gf.ParticleForce(oscillating, parameters)]) as simulation:
        simulation.run(until=0.01)
        expected = 10.0 / 500.0 * math.sin(500.0 * simulation.time)
        assert simulation.particles.velocity[0, 1] == pytest.approx(expected, rel=1e-4)


def test_budget_closes_with_contacts_and_neighbor_list_rebuilds(taichi_f64):
    """Particles bounce on a floor under drag and a field; more than one chunk and many rebuilds."""
    grid = np.stack(np.meshgrid(*[np.arange(5)] * 3, indexing="ij"), -1).reshape(-1, 3)
    groups = {"balls": particle_group(0.011 * grid + [0.0, 0.0, 0.01], velocity=[0.3, 0.2, -1.0])}
    scene = build_scene(
        groups, walls={"floor": plane([0.0] * 3, [0.0, 0.0, 1.0])}, pair={"friction": 0.3},
        output={"interval": 1.0, "energy_budget": True}, numerics={"chunk_size": 16},
    )  # fmt: skip
    forces = [
        gf.ParticleForce(field, {"acceleration": (0.0, 0.0, -30.0)}),
        gf.ParticleForce(stokes_drag, {"viscosity": 1.0}),
    ]
    with gf.Simulation(scene, forces=forces) as simulation:
        simulation.run(until=0.02)
        totals = simulation.snapshot().totals
        assert totals["friction_dissipation"] > 0.0 and simulation.engine.timing.rebuild_count > 5
        assert abs(totals["energy_error"]) < 1e-3


def test_a_scene_without_forces_has_no_arrays_for_them(taichi_f64):
    with gf.Simulation(flying()) as simulation:
        state = simulation.engine.state
        assert state.particles.external_force is None and state.control.external_work is None
        assert state.control.force_clock is None and "external_work" not in simulation.snapshot().totals


def invalid(position, velocity, radius, mass, time, parameters):
    return parameters.acceleration * ti.sqrt(parameters.limit - position[0])


@pytest.mark.parametrize("acceleration", [1.0, 1e9])
def test_the_message_of_an_abort_names_the_force(taichi_f64, acceleration):
    """The square root is not a number beyond the limit; the large force exceeds the displacement limit
    before."""
    force = gf.ParticleForce(invalid, {"limit": 1e-3, "acceleration": [acceleration, 0.0, 0.0]})
    with gf.Simulation(flying(), forces=[force]) as simulation, pytest.raises(gf.RunError) as stopped:
        simulation.run()
    message = str(stopped.value)
    assert ("is not a number. It has no contacts" in message) == (acceleration == 1.0)
    assert message.endswith("The force from Python may also be the cause: check the values of invalid.")
    assert "f64" not in message


def scalar(position, velocity, radius, mass, time, parameters):
    return mass


def unknown(position, velocity, radius, mass, time, parameters):
    return mass * parameters.viscosiy * velocity


def test_a_function_with_other_arguments_is_refused():
    with pytest.raises(
        gf.GranflowError, match=r"force <lambda> takes \(position, velocity\), but must take \(position, "
    ):
        gf.ParticleForce(lambda position, velocity: velocity)


def test_functions_and_parameters_that_are_not_valid_are_refused(taichi_f64):
    with gf.Simulation(flying()) as simulation:
        for function, message in ((scalar, "vector of three"), (unknown, "viscosiy")):
            with pytest.raises(gf.FunctionError, match=f"force {function.__name__} at 0 s cannot.*{message}"):
                simulation.forces.append(gf.ParticleForce(function, {"viscosity": 1.0}))
        simulation.forces.append(force := gf.ParticleForce(stokes_drag, {"viscosity": 1.0}))
        with pytest.raises(gf.GranflowError, match="has two forces stokes_drag"):
            simulation.forces.append(gf.ParticleForce(stokes_drag))
        for name, value, message in (
            ("viscosiy", 1.0, "has no parameter viscosiy; its parameters are viscosity"),
            ("viscosity", math.nan, "is nan, but must be a finite number"),
            ("viscosity", [1.0, 2.0, 3.0], "must remain a number"),
        ):
            with pytest.raises(gf.GranflowError, match=message):
                force.parameters[name] = value
