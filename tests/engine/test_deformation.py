"""Deforming boxes: affine motion, Hertzian lattices under pressure, and the place of the boundary."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from scene_builders import SOFT, build_scene, particle_group, run_to_end

from granflow.errors import GranflowError, RunError, SceneError
from granflow.load import Scene
from granflow.parallel.refusals import refuse_on_ranks
from granflow.plan.build import plan_for
from granflow.runs.read_run import read_run
from granflow.runs.stages import box_off_target
from granflow.simulation import Simulation

AXES = "xyz"
SIDE = 0.03
"""Width of the box at the start [m]."""


def deformed(positions, deformation, diameter=0.01, duration=0.01, pair=None, stages=None, velocity=None):
    """Spheres in a periodic cube that deforms."""
    moving = {} if velocity is None else {"velocity": velocity}
    run = {"velocity_max": 1.0, "time_step": 4e-6}
    box = {"min": [0.01] * 3, "max": [0.01 + SIDE] * 3, "periodic": ["x", "y", "z"], "on_exit": "error"}
    return build_scene(
        {"balls": particle_group(positions, diameter, **moving)},
        normal="hertz",
        numerics={"chunk_size": 16},
        pair={"restitution": 1.0} | (pair or {}),
        domain=box | {"deformation": deformation},
        output={"interval": 1.0, "energy_budget": True},
        **({"run": run, "stages": stages} if stages else {"run": run | {"duration": duration}}),
    )


def lattice(count=3):
    """Centers of a simple cubic lattice in the box."""
    return 0.01 + SIDE / count * (np.argwhere(np.ones((count,) * 3)) + 0.5)


def of_axes(last, name):
    """A total of each axis."""
    return np.array([last.totals[f"{name}_{axis}"] for axis in AXES])


STIFFNESS = 4 / 3 * SOFT["young_modulus"] / (2 * (1 - SOFT["poisson_ratio"] ** 2)) * np.sqrt(0.0025)
"""F / overlap^1.5 of two spheres of 10 mm: (4/3) E* sqrt(R*), with 1/R* = 2/R and 1/E* = 2 (1 - nu^2) / E."""


def test_cubic_lattice_has_hertzian_pressures_and_reaches_targets(taichi_f64):
    """A contact per area of a cell along each axis: P_x = F(d - a_x) / (a_y a_z), with a = W/3.

    The stored energy (2/5) F overlap of all contacts is the work of the box.
    """
    target = np.array([2e3, 3e3, 4e3])
    rates = {axis: {"strain_rate": rate} for axis, rate in zip(AXES, (-1.0, -2.0, -0.5), strict=True)}
    control = {axis: {"pressure": value} for axis, value in zip(AXES, target, strict=True)}
    stages = [
        {"name": "rates", "duration": 0.004},
        {"name": "pressures", "duration": 0.02, "deformation": control | {"max_rate": 2.0}},
    ]
    for count in (1, 2):
        last, _ = run_to_end(deformed(lattice(), rates, stages=stages[:count]))
        if count == 1:
            width = SIDE * np.exp(np.array([-1.0, -2.0, -0.5]) * last.time)
            np.testing.assert_allclose(of_axes(last, "box_width"), width, rtol=1e-10)
        cell = of_axes(last, "box_width") / 3
        overlap = 0.01 - cell
        force = STIFFNESS * overlap**1.5
        assert overlap.min() > 1e-5
        fraction = 27 * np.pi / 6 * 0.01**3 / of_axes(last, "box_width").prod()
        assert last.totals["solid_fraction"] == pytest.approx(fraction)
        np.testing.assert_allclose(of_axes(last, "box_pressure"), force * cell / cell.prod(), rtol=1e-8)
        stored = 27 * (2 / 5 * force * overlap).sum()
        assert last.totals["elastic_energy"] == pytest.approx(stored, rel=1e-8)
        moving = last.totals["kinetic_energy"]
        assert abs(last.totals["energy_error"]) < 1e-5
    np.testing.assert_allclose(of_axes(last, "box_pressure"), target, rtol=1e-3)
    assert moving < 1e-3 * stored
    assert last.totals["box_pressure"] == pytest.approx(3e3, rel=1e-3)
    assert last.totals["stress_ratio"] == pytest.approx(np.sqrt(3.0) / 3.0, rel=1e-3)  # q = sqrt(3) kPa


CONTROL = {axis: {"pressure": 4e3} for axis in AXES} | {"max_rate": 2.0}


def approach(control, until):
    """A lattice near its target pressures at the end of a compression, and the control from then on."""
    rates = {axis: {"strain_rate": -0.9} for axis in AXES}
    control = {"name": "control", "duration": until - 0.003, "deformation": control}
    return deformed(
        lattice(), rates, stages=[{"name": "rates", "duration": 0.003, "deformation": rates}, control]
    )


@pytest.mark.parametrize("share", [0.8, 1.3])
def test_pressure_alternates_above_the_stability_limit_of_the_gain(taichi_f64, share):
    """P - P0 shrinks by 1 - K g dt in a step, with K = dF/d(overlap) / a of a cubic lattice of the width a. Above
    the limit 2 / (K dt), the strain of each step is max_rate dt. A warning names an estimate of the limit."""
    overlap = (4e3 * 0.01**2 / STIFFNESS) ** (2 / 3)
    stiffness = 1.5 * STIFFNESS * overlap**0.5 / 0.01
    limit = 2.0 / (stiffness * 4e-6)
    scene = approach(CONTROL | {"gain": share * limit}, 0.012)
    with Simulation(scene) as simulation:
        simulation.run(until=0.012 - 4e-6)
        before = of_axes(simulation.snapshot(), "box_pressure")
        simulation.step(1)
        last = of_axes(simulation.snapshot(), "box_pressure")
    if share < 1.0:
        np.testing.assert_allclose([before, last], 4e3, rtol=1e-6)
    else:
        np.testing.assert_allclose(np.abs(last - before), stiffness * 2.0 * 4e-6, rtol=0.01)
    warnings = [each.warning for each in plan_for(scene).forecasts if "gain" in (each.warning or "")]
    assert len(warnings) == (share > 1.0)
    if warnings:
        named = float(warnings[0].split("limit of about ")[1].split(" ")[0])
        assert named == pytest.approx(limit, rel=0.15)


def test_pressures_off_their_targets_are_a_warning_and_frames_have_the_widths(taichi_f64, tmp_path):
    """With a small gain, the rate is gain times the deviation."""
    scene = approach(CONTROL | {"z": {"strain_rate": 0.0}, "gain": 1e-5}, 0.005)
    with Simulation(scene, out=tmp_path / "run") as simulation:
        simulation.run()
        last = simulation.snapshot()
        (without_samples,) = box_off_target(simulation.engine, "control", [])
    (sentence,) = [each for each in read_run(tmp_path / "run").result.warnings if "off its target" in each]
    assert without_samples == sentence  # a stage that ends before its first sample
    reached = of_axes(last, "box_pressure")
    for k in (0, 1):
        assert f"{AXES[k]}: {reached[k]:.3g} Pa instead of 4e+03 Pa" in sentence
    assert f"at up to {1e-5 * (reached[0] - 4e3):.3g} 1/s, gain times the deviation" in sentence
    frame = sorted((tmp_path / "run").glob("particles_*.vtu"))[-1]
    arrays = {each.get("Name"): each.text for each in ElementTree.parse(frame).getroot().iter("DataArray")}
    found = [float(arrays[f"box_width_{axis}"]) for axis in AXES]
    np.testing.assert_array_equal(found, of_axes(last, "box_width"))


def test_tension_requires_contacts_that_pull():
    """A negative target is refused for Hertz contacts, not with cohesion."""
    scene = deformed(lattice(), {"x": {"pressure": -100.0}, "max_rate": 1.0})
    with pytest.raises(SceneError, match=r"domain\.deformation\.x\.pressure is -100 Pa, but hertz contacts"):
        plan_for(scene)
    given = scene.to_dict()
    given["contact"]["cohesion"] = "sjkr"
    given["pairs"]["glass-glass"]["cohesion_energy_density"] = 1e4
    assert plan_for(Scene.from_dict(given)).laws.attracts


def test_overlap_of_a_compressed_box_names_the_box_and_a_narrow_box_stops_the_run(taichi_f64):
    """No text on walls and weight: a box without walls is compressed beyond the overlap limit."""
    given = deformed(lattice(), {axis: {"strain_rate": -10.0} for axis in AXES}, duration=0.02).to_dict()
    given["numerics"]["max_overlap"] = 0.1
    with pytest.raises(RunError, match="the deforming box presses the particles together: end the") as error:
        run_to_end(Scene.from_dict(given))
    approach = float(str(error.value).split("They approach at ")[1].split(" ")[0])  # also across a face
    assert approach == pytest.approx(10.0 * (0.01 - 0.1 * 0.005), rel=5e-3)
    assert "wall" not in str(error.value) and "weight" not in str(error.value)
    narrow = deformed([[0.02] * 3], {"x": {"strain_rate": -40.0}}, diameter=0.004, duration=0.1)
    with pytest.raises(RunError, match=r"the periodic box along x at 0\.\d+ s is narrower than 0\.0\d+ m"):
        run_to_end(narrow)


def test_result_does_not_depend_on_the_position_of_the_boundary(taichi_f64):
    """A frictional gas, and the same gas shifted by a third of the width: equal in relative coordinates."""
    rng = np.random.default_rng(3)
    start = 0.01 + 0.006 * (np.argwhere(np.ones((5, 5, 5))) + 0.5)
    velocity = rng.normal(0.0, 0.2, start.shape)
    velocity -= velocity.mean(axis=0)
    deformation = {axis: {"strain_rate": rate} for axis, rate in zip(AXES, (-8.0, -4.0, 3.0), strict=True)}
    found = []
    for shift in (0.0, 1 / 3):
        positions = 0.01 + (start - 0.01 + shift * SIDE) % SIDE
        pair = {"friction": 0.4, "restitution": 0.8}
        last, simulation = run_to_end(deformed(positions, deformation, 0.0055, 0.02, pair, velocity=velocity))
        assert last.totals["friction_dissipation"] > 1e-6 and simulation.engine.timing.rebuild_count > 3
        assert abs(last.totals["energy_error"]) < 2e-3
        width = of_axes(last, "box_width")
        relative = (last.particles["position"] - 0.01) / width
        assert relative.min() >= 0.0 and relative.max() < 1.0
        fluctuation = last.particles["velocity"] - relative * width * (-8.0, -4.0, 3.0)
        found.append(((relative - shift) % 1.0, fluctuation, last.particles["angular_velocity"]))
    difference = (found[1][0] - found[0][0] + 0.5) % 1.0 - 0.5
    np.testing.assert_allclose(difference, 0.0, atol=1e-7)
    np.testing.assert_allclose(found[1][1], found[0][1], atol=2e-5)
    np.testing.assert_allclose(found[1][2], found[0][2], atol=2e-2)


def test_ranks_refuse_deforming_boxes():
    scene = deformed(lattice(), {"x": {"strain_rate": -1.0}})
    with pytest.raises(GranflowError, match=r"domain\.deformation does not work on MPI ranks"):
        refuse_on_ranks(scene=scene)
