"""A program of a user that `mypy --strict` checks in test_types.py; it is not executed."""

from typing import Any

import numpy as np

import granflow as gf


def report(snapshot: gf.Snapshot) -> None:
    print(snapshot.time, snapshot.totals["kinetic_energy"], snapshot.particles["velocity"][:, 2].min())


def drag(position: Any, velocity: Any, radius: Any, mass: Any, time: Any, parameters: Any) -> Any:
    return -parameters.viscosity * radius * velocity


scene: gf.Scene = gf.Scene(
    title="Beads",
    gravity=[0, 0, -9.81],
    materials={"glass": gf.Material(preset="glass", young_modulus="60 MPa")},
    pairs={"glass-glass": gf.MaterialPair(restitution=0.8, friction=0.5)},
    contact=gf.Contact(normal="zhou", tangential="mindlin", rolling="epsd"),
    walls={"gate": gf.Plane(material="glass", point=[0, 0, 0], normal=[0, 0, 1])},
    particles={"feed": gf.Group(material="glass", count=9, diameter="4 mm", insert=gf.PythonInsertion())},
    domain=gf.Domain(min=[-0.1, -0.1, -0.1], max=[0.1, 0.1, 0.1], on_exit="error"),
    run=gf.RunSettings(duration="20 ms"),
    output=gf.Output(interval="4 ms"),
)
force = gf.ParticleForce(drag, parameters={"viscosity": 1.0, "axis": [0, 0, 1]})
observer = gf.on_interval("1 ms", report)
with gf.Simulation(scene, precision="mixed", threads=2, out="out", observers=[observer]) as simulation:
    particles = simulation.particles
    ids: np.ndarray[Any, Any] = particles.add(position=np.zeros((3, 3)), diameter=0.004, velocity=[0, 0, 1])
    simulation.step(10)
    result: gf.Result = simulation.run(until=0.2)
    particles.velocity[particles.group == "feed"] *= 0.5
    particles.velocity = np.zeros((3, 3))
    particles.diameter[particles.rows([1, 2])] = 0.004
    particles.group = "feed"
    particles.remove(particles.position[:, 0] < 0)
    simulation.walls["gate"].motion = [gf.Translation(velocity=[0, 0, 1])]
    simulation.walls["gate"].remove()
    simulation.observers.remove(observer)
    simulation.forces.append(force)
    force.parameters["axis"] = [0, 0, 2]
    snapshot: gf.Snapshot = simulation.snapshot(contacts=True)
    simulation.save()
run: gf.Run = gf.read_run("out")
print(run.status, run.timeseries_arrays["time"][-1], run.frames[-1].time, run.result and run.result.totals)
