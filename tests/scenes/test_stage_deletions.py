"""Particles that stages delete: which ones, their energies, and walls that appear in their place."""

from types import SimpleNamespace

import numpy as np
import pytest

from granflow import StageDeletion
from granflow.engine.selection import PresentParticles
from granflow.simulation import Simulation
from tests.scene_builders import build_scene, particle_group, plane

POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.6, 0.6, 0.0], [0.0, 0.0, 1.01], [-0.1, 0.0, 0.0]])
ROOT = float(np.hypot(0.6, 0.6))
REGIONS = [
    ({"box": {"min": [0, 0, 0], "max": [1, 1, 1]}}, [0.0, 0.0, 0.0, 0.01, 0.1]),
    ({"box": {"min": [-2, -2, -2], "max": [0.6, 0.3, 1.5]}}, [-0.3, 0.4, 0.3, -0.3, -0.3]),
    ({"half_space": {"point": [0, 0, 0], "normal": [-2, 0, 0]}}, [0.0, 1.0, 0.6, 0.0, -0.1]),
    ({"cylinder": {"from": [0, 0, 0], "to": [0, 0, 2], "radius": 0.8}}, [0.0, 0.2, ROOT - 0.8, -0.8, 0.0]),
    ({"cylinder": {"from": [0, 0, 0], "to": [1, 0, 0], "radius": 0.5}}, [0.0, 0.0, 0.1, 0.51, 0.1]),
    ({"sphere": {"center": [0, 0, 0], "radius": 1}}, [-1.0, 0.0, ROOT - 1.0, 0.01, -0.9]),
]  # fmt: skip
"""Regions, and the distances of POINTS from their surfaces."""


@pytest.mark.parametrize(("region", "distance"), REGIONS)
def test_regions_have_signed_distances(region, distance):
    assert StageDeletion(region=region).region.distance(POINTS) == pytest.approx(
        np.array(distance), abs=1e-12
    )
    arrays = {"radius": np.full(5, 0.3)}
    spheres = SimpleNamespace(
        group=np.zeros(5, int), body=np.arange(5), arrays=arrays, _center=POINTS, _position=POINTS
    )
    for part, reach in (("center", 0.0), ("any", 0.3), ("all", -0.3)):
        deletion = StageDeletion(region=region, part=part)
        found = PresentParticles.chosen(spheres, None, deletion.region, deletion.part)
        is_clear = np.abs(np.array(distance) - reach) > 1e-9
        assert (found == (np.array(distance) <= reach))[is_clear].all()


def test_a_stage_deletes_particles_before_its_walls_appear():
    """Two columns of two touching spheres on a floor, two falling ones. The stage deletes the upper spheres, in whose
    place a lid appears, and a falling one; a program removes the other one just before, which counts once. The
    budget is closed, with the elastic energy, which is more than 5e-4 of all."""
    radius, overlap = 0.005, 2e-5
    low, high = radius - overlap, 3 * radius - 2 * overlap
    columns = [[x, 0.0, z] for x in (0.0, 0.02) for z in (low, high)]
    falling = particle_group([[0.04, 0.0, 0.3], [0.06, 0.0, 0.3]], velocity=[[0.0, 0.0, -1.0]] * 2)
    region = {"half_space": {"point": [0.0, 0.0, 2 * radius], "normal": [0.0, 0.0, 1.0]}}
    delete = [{"region": region, "groups": ["columns"]}, {"groups": ["falling"]}]
    lid = plane([0.0, 0.0, high], [0.0, 0.0, -1.0]) | {"stages": ["closed"]}
    scene = build_scene(
        {"columns": particle_group(columns), "falling": falling},
        {"floor": plane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]), "lid": lid},
        gravity=[0.0, 0.0, -9.81], run={"time_step": 1e-6}, normal="hertz",
        stages=[{"name": "open", "duration": 1e-5}, {"name": "closed", "duration": 1e-4, "delete": delete}],
        output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip
    simulation = Simulation(scene)
    simulation.run(8e-6)
    before = simulation.snapshot().totals
    simulation.run(1e-5)  # to the end of the first stage; the second one begins with the next step
    simulation.particles.remove([5])
    simulation.run()
    after = simulation.snapshot()
    simulation.free()
    assert after.particles["id"].tolist() == [0, 2]
    mass = 2500.0 * np.pi / 6.0 * (2.0 * radius) ** 3
    assert after.totals["deleted_count"] == 4.0 and after.totals["deleted_mass"] == pytest.approx(4 * mass)
    speed, height = 1.0 + 9.81e-5, 0.3 - 1e-5 - 0.5 * 9.81e-10
    of_spheres = 2 * mass * (0.5 * speed**2 + 9.81 * height) + 2 * mass * 9.81 * high
    elastic = before["elastic_energy"]
    removed = after.totals["removed_energy"] - before["removed_energy"]
    assert of_spheres < removed < of_spheres + 1.01 * elastic
    assert elastic > 5e-4 * removed
    assert abs(after.totals["energy_error"] - before["energy_error"]) < 1e-4
