"""Use that cannot be meant: other types, other threads, forks, calls from observers; each has one clear
sentence."""

import copy
import multiprocessing
import threading

import numpy as np
import pytest
from api.scenes import beads
from subprocess_runner import in_subprocess

import granflow as gf


def drag(position, velocity, radius, mass, time, parameters):
    return -parameters.rate * mass * velocity


def seen(snapshot):
    """Does nothing."""


def generator(snapshot):
    """Would never run: a call only creates the generator."""
    yield snapshot


@pytest.fixture(scope="module")
def simulation(taichi_f64):
    """A simulation with a force and an observer after three steps."""
    force = gf.ParticleForce(drag, {"rate": 0.5})
    with gf.Simulation(beads(), forces=[force], observers=[gf.on_interval(1e-3, seen)]) as found:
        found.step(3)
        yield found


VECTORS = np.zeros((2, 3))
DATA = (VECTORS, VECTORS.T, VECTORS, np.ones(2), np.zeros(2, np.int32), np.zeros(2, np.int32))


def velocity(value):
    """Assigns velocities."""
    return lambda s: setattr(s.particles, "velocity", value)


WRONG = {
    "path is 5, but must be a path": lambda _: gf.load_scene(5),
    "overrides is 'run.duration=1', but": lambda _: gf.load_scene("a.yaml", "run.duration=1"),
    "precision is 'f16'; give one of f64, f32, mixed.": lambda _: gf.Simulation(beads(), precision="f16"),
    "arch is 'tpu'; give one of cpu, cuda, vulkan, gpu.": lambda _: gf.start("tpu"),
    "history contains (0.0, 1.0), but must have rows of": lambda _: gf.steady_flow([(0.0, 1.0)]),
    "model is 5, but must be a ContactModel": lambda _: gf.register_contact_model(5),
    "ParticleData: velocity has the shape (3, 2), but must have (2, 3)": lambda _: gf.ParticleData(*DATA),
    "force drag: parameters is 5, but must be a mapping": lambda _: gf.ParticleForce(drag, 5),
    "interval is True, but must be a number [s] or text": lambda _: gf.on_interval(True, seen),
    "is a generator or a coroutine, whose code a call does not": lambda _: gf.on_interval(1, generator),
    "function is 3, but must be a function of a snapshot": lambda _: gf.on_interval(1, 3),
    "must be a list of": lambda _: gf.Simulation(beads(), observers=gf.on_interval(1, seen)),
    "resume is 5, but must be a directory": lambda _: gf.Simulation(beads(), resume=5),
    "scene is of type dict; make a scene of it with granflow.Scene.from_dict": lambda _: gf.Simulation(
        {"a": 1}
    ),
    "count is nan, but must be a whole number": lambda s: s.step(float("nan")),
    "until is -1 s, but the simulation is at": lambda s: s.run(until=-1.0),
    "save needs an output directory": lambda s: s.save(),
    "run takes until or duration, not both": lambda s: s.run(until=1.0, duration=1.0),
    "request_stop takes an exception": lambda s: s.request_stop("now"),
    "is '3 m/s', but must be real numbers": velocity("3 m/s"),
    "contains 1e+200; a value of this": velocity(VECTORS + 1e200),
    "drag has no parameter viscosity; its parameters are rate": lambda s: s.forces[0].parameters.update(
        viscosity=1
    ),
    "the parameter rate must remain a number": lambda s: s.forces[0].parameters.update(rate=[1.0, 2.0, 3.0]),
    "has two forces drag": lambda s: s.forces.append(gf.ParticleForce(drag, {"rate": 1.0})),
    "A simulation can neither be pickled nor copied": copy.deepcopy,
}
"""A part of the sentence, and the call with an argument that cannot be meant."""


@pytest.mark.parametrize("message", WRONG)
def test_a_wrong_argument_is_refused_with_one_sentence_and_changes_nothing(simulation, message):
    before = simulation.particles.velocity[:]
    step_count = simulation.step_count
    with pytest.raises(gf.GranflowError) as error:
        WRONG[message](simulation)
    assert message in str(error.value) and "\n" not in str(error.value)
    np.testing.assert_array_equal(simulation.particles.velocity, before)
    assert (
        simulation.step_count == step_count and len(simulation.particles) == 2 and len(simulation.forces) == 1
    )


ASSIGNMENTS = (
    "simulation.forces = []", "simulation.gravity = 3.0", "simulation.forces[0] = None", "simulation.walls['floor'] = None",
    "simulation.walls['floor'].velocity = [0, 0, 1]", "simulation.particles.speed = 1", "simulation.particles.mass = 1",
    "for row in simulation.particles.velocity: row *= 0.5", "simulation.observers[0].interval = 1e-5",
    "simulation.forces[0].name = 'other'", "scene.materials['glass'].density = 3", "simulation.plan.skin = 1.0",
)  # fmt: skip


@pytest.mark.parametrize("statement", ASSIGNMENTS)
def test_an_assignment_without_effect_is_refused(simulation, statement):
    with pytest.raises((AttributeError, gf.GranflowError, TypeError, ValueError)) as error:
        exec(statement, {"simulation": simulation, "scene": beads()})
    assert str(error.value) and "\n" not in str(error.value)


def test_an_observer_belongs_to_one_simulation_at_a_time(taichi_f64):
    """After the end of the first one it begins again in the next one."""
    times = []
    observer = gf.on_interval(1e-3, lambda snapshot: times.append(snapshot.time))
    for _ in range(2):
        with gf.Simulation(beads(), observers=[observer]) as simulation:
            simulation.run()
            with pytest.raises(gf.GranflowError, match="is an observer of another simulation, which has not"):
                gf.Simulation(beads(), observers=[observer])
    assert len(times) == 10 and times[:5] == times[5:]


@pytest.mark.parametrize("method", ["step", "free"])
def test_an_observer_cannot_advance_or_end_its_simulation(taichi_f64, method):
    with gf.Simulation(beads()) as simulation:
        observer = gf.on_interval(1e-3, lambda snapshot: getattr(simulation, method)(), wants=["walls"])
        simulation.observers.append(observer)
        with pytest.raises(gf.FunctionError, match="cannot be called by an observer, while the simulation"):
            simulation.run()
        simulation.observers.remove(observer)
        simulation.run()
        assert simulation.is_complete


def in_thread(function, *arguments):
    """The result of a function in another thread, or the message of its exception."""
    found = []

    def target():
        try:
            found.append(function(*arguments))
        except Exception as error:
            found.append(f"{type(error).__name__}: {error}")

    thread = threading.Thread(target=target, name="worker")
    thread.start()
    thread.join()
    return found[0]


def test_a_simulation_is_used_in_its_own_thread_only(simulation):
    """Two threads would mix their steps. Times may be read, and a stop requested."""
    before = simulation.step_count
    for call in (
        simulation.step, simulation.snapshot, simulation.run, simulation.free,
        lambda: simulation.particles.velocity[:], lambda: simulation.walls["floor"].pose,
        lambda: simulation.forces.remove(simulation.forces[0]),
    ):  # fmt: skip
        message = in_thread(call)
        assert message.startswith("GranflowError: This simulation belongs to the thread MainThread"), message
    assert "in use in the thread MainThread" in in_thread(lambda: gf.Simulation(beads()))
    assert in_thread(lambda: (simulation.time, simulation.step_count, simulation.stage))[1] == before
    in_thread(simulation.request_stop, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        simulation.run(duration=1e-4)
    simulation.step(2)
    assert simulation.step_count > before, "the run continues after the stop"


def positions_of_runs():
    """Positions at the end of a run in another thread and in the main thread, and the message of a fork."""

    def whole():
        with gf.Simulation(beads()) as simulation:
            simulation.run()
            return simulation.particles.position[:].tolist()

    def step(sender):
        try:
            simulation.step()
        except gf.GranflowError as error:
            sender.send(str(error))

    found = [in_thread(whole), whole()]
    with gf.Simulation(beads()) as simulation:
        simulation.step(3)
        receiver, sender = multiprocessing.Pipe(duplex=False)
        child = multiprocessing.get_context("fork").Process(target=step, args=(sender,))
        child.start()
        child.join(30)
        found.append(receiver.recv() if receiver.poll(1) else "no answer")
        child.kill()
        simulation.step(3)
    return found


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="the system has no fork")
def test_threads_take_turns_and_a_fork_is_refused():
    first, second, message = in_subprocess(positions_of_runs)
    assert first == second
    assert 'multiprocessing.get_context("spawn") instead of "fork"' in message
