"""Particles that leave the domain outside the outlets are reported at the end of a run, with the face of the
domain."""

import json

import pytest
from scene_builders import build_scene, particle_group

from granflow.io.checkpoint import checkpoint_at
from granflow.simulation import Simulation

DOMAIN = {"min": [-0.1, -0.1, -0.02], "max": [0.1, 0.1, 0.1], "on_exit": "delete"}
HOLE = {"hole": {"box": {"min": [-0.02, -0.02, -0.02], "max": [0.02, 0.02, -0.01]}}}


def scene(aside=2, outlets=None, meter=None):
    """Three particles at the height 0 fall; the others at 5 cm fly 10 cm along x in 45 ms and fall 10 mm."""
    at = [[0.012 * k - 0.012, 0.0, 0.0] for k in range(3)]
    diameters = [0.01, 0.01, 0.0099]  # the structure of scenes without output whose diameters differ
    groups = {"falling": particle_group(at, diameters, velocity=[0.0, 0.0, -1.0])}
    if aside:
        groups["flying"] = particle_group([[x, 0.0, 0.05] for x, *_ in at[:2]], velocity=[2.5, 0.0, 0.0])
    sides = [[0.0, 0.2, 0.0], [0.0, 0.0, 0.12]]
    plate = {"point": [meter, -0.1, -0.02], "normal": [1, 0, 0], "sides": sides}
    output = {"interval": 0.01, "flow_meters": {"plate": plate} if meter else {}}
    parts = {"run": {"duration": 0.06, "velocity_max": 3.0}, "domain": DOMAIN, "output": output}
    return build_scene(groups, outlets=outlets or {}, gravity=[0.0, 0.0, -9.81], **parts)


def warnings_of(given, **options):
    simulation = Simulation(given, **options)
    found = simulation.run().warnings
    simulation.free()
    return [each for each in found if "left the domain" in each]


@pytest.mark.parametrize(
    ("options", "count"),
    [
        ({}, 5),
        ({"outlets": HOLE, "aside": 0}, 0),
        ({"aside": 0}, 0),
        ({"meter": 0.08}, 0),
        ({"meter": -0.08}, 5),
    ],
    ids=["no outlet", "outlet", "drained", "meter", "meter elsewhere"],
)
def test_particles_that_leave_the_domain_outside_the_outlets_are_reported(taichi_f64, options, count):
    found = warnings_of(scene(**options))
    assert len(found) == (count > 0)
    assert not found or found[0].startswith(f"{count} of 5 particles left the domain, ")


def test_the_count_is_in_all_files_and_kept_by_a_resumed_run(taichi_f64, tmp_path):
    out = tmp_path / "run"
    given = scene(outlets=HOLE)
    with Simulation(given, out=out) as simulation:
        simulation.run(until=0.055)
    assert checkpoint_at(out).saved["engine"]["accounting"]["exits"]["x_max"] == 2
    (warning,) = warnings_of(given, out=out, resume=out)
    assert warning.startswith("2 of 5 particles left the domain outside the outlets, ")
    assert "2 of them through its face at x = 0.1 m" in warning and "domain.max" in warning
    assert warning in json.loads((out / "result.json").read_text())["warnings"]
    assert warning in (out / "run.log").read_text()
