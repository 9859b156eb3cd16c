"""Forecasts: overlaps of impacts and static pressures, walls and regions at wrong places, servos that reach
nothing."""

import re
from math import log, pi, sqrt

import numpy as np
import pytest
from geometry.meshes import cube, write
from plan.scenes import TEXT, scene_of
from scene_builders import build_scene, particle_group, plane
from scipy.integrate import solve_ivp

from granflow import load_scene
from granflow.cli.run import scene_paths
from granflow.errors import SceneError
from granflow.particles.insertion import initial_particles
from granflow.plan import overlaps
from granflow.plan.build import plan_for
from granflow.plan.overlaps import (
    impact_overlap,
    impact_velocity,
    particle_warnings,
    refuse_initial_overlaps,
    required_moduli,
    touching_pairs,
)
from granflow.plan.walls import surface_speed
from granflow.runs.initial_particles import initial_state

SCENES = list(scene_paths().values())
RUBBER = {"rubber": {"young_modulus": 5e6, "poisson_ratio": 0.48, "density": 1100.0}}
FLOOR = plane([0, 0, 0], [0, 0, 1], "rubber")


def warnings_of(scene):
    return [each.warning for each in plan_for(scene).forecasts if each.warning]


def forecast(scene, name):
    return next(each for each in plan_for(scene).forecasts if each.name == name)


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_shipped_scenes_cause_no_warning(path):
    assert warnings_of(load_scene(path)) == []


def rubber_ball(velocity=2.5, **parts):
    ball = particle_group([[0.0, 0.0, 0.1]], material="rubber")
    usual = {"run": {"duration": 0.1, "velocity_max": velocity}, "normal": "hertz", "materials": RUBBER}
    return build_scene(
        {"ball": ball}, walls={"floor": FLOOR}, **usual | {"pair": {"restitution": 1.0}} | parts
    )


def test_overlap_of_an_impact_follows_from_its_energy():
    """Elastic sphere at a wall of its material, E* = E / (2 (1 - nu^2)):

        d/R = (5 m v^2 / (4 k))^0.4 / R,   k = 4/3 E* sqrt(R),   m = 4/3 pi R^3 rho
            = (5 pi rho v^2 / (4 E*))^0.4 = 0.147 at 2.5 m/s

    The overlap is proportional to E^-0.4: 5 MPa (d / 0.1 R)^2.5 is the modulus that is just enough.
    """
    modulus_eff = 5e6 / (2.0 * (1.0 - 0.48**2))
    overlap = (1.25 * pi * 1100.0 * 2.5**2 / modulus_eff) ** 0.4
    found = forecast(rubber_ball(), "overlap of impacts")
    assert found.overlap == pytest.approx(overlap, rel=1e-3) and overlap == pytest.approx(0.147, abs=5e-4)
    damped = forecast(rubber_ball(pair={"restitution": 0.3}), "overlap of impacts").overlap
    assert damped < 0.9 * overlap, "viscous forces lower the overlap"
    enough = 5e6 * (overlap / 0.1) ** 2.5
    advised = float(found.warning.split("young_modulus to ")[1].split(" MPa")[0]) * 1e6
    assert enough < advised < 1.2 * enough
    stiffer = {"rubber": RUBBER["rubber"] | {"young_modulus": advised}}
    ball = particle_group([[0.0, 0.0, 0.1]], material="rubber")
    run = {"duration": 0.1, "velocity_max": 2.5}
    followed = build_scene(
        {"ball": ball}, {"floor": FLOOR}, {"restitution": 1.0}, normal="hertz", materials=stiffer, run=run
    )
    assert warnings_of(followed) == []
    assert warnings_of(rubber_ball(numerics={"max_overlap": 0.21})) == []


def test_groups_that_differ_in_their_names_alone_are_forecast_once(monkeypatch):
    """The integration of an impact takes milliseconds, and 24 groups have 300 pairs."""
    cases = []

    def counted(laws, pair, velocity, enough):
        cases.append((pair.radius_eff, pair.mass_eff, pair.pair.modulus_eff))
        return impact_overlap(laws, pair, velocity, enough)

    monkeypatch.setattr(overlaps, "impact_overlap", counted)
    balls = {f"ball_{k}": particle_group([[0.0, 0.05 * k, 0.1]], material="rubber") for k in range(4)}
    run = {"duration": 0.1, "velocity_max": 2.5}
    scene = build_scene(
        balls, {"floor": FLOOR}, {"restitution": 0.9}, normal="hertz", materials=RUBBER, run=run
    )
    assert len(warnings_of(scene)) == 1
    assert 2 < len(cases) == len(set(cases))


def test_only_the_softer_material_of_a_pair_changes():
    """A factor of 2 with a margin of 10 %, rounded up to two digits: 5 MPa 2.2 = 12 MPa.

    1/E* = c1/E1 + c2/E2 with c = 1 - nu^2: 100 times the modulus requires that the wall becomes stiffer too.
    """
    solids = rubber_ball().materials | {"steel": load_scene(SCENES[0]).materials["glass"]}
    assert required_moduli(solids, ("rubber", "rubber"), 2.0) == {"rubber": 1.2e7}
    moduli = required_moduli(solids, ("rubber", "steel"), 100.0)
    assert set(moduli) == {"rubber", "steel"} and moduli["rubber"] == moduli["steel"]


def bed(modulus, **more):
    """300 particles of 4 mm above a floor of 24 mm x 24 mm in a domain of 26 mm x 26 mm."""
    glass = {"glass": {"young_modulus": modulus, "poisson_ratio": 0.25, "density": 2500.0}}
    region = {"box": {"min": [0.0, 0.0, 0.0], "max": [0.024, 0.024, 0.095]}}
    group = {
        "material": "glass", "count": 300, "diameter": 0.004, "insert": {"kind": "pack", "region": region}
    }  # fmt: skip
    domain = {"min": [-0.001] * 3, "max": [0.025, 0.025, 0.11], "on_exit": "delete"}
    parts = {
        "gravity": [0.0, 0.0, -9.81], "normal": "hertz", "run": {"duration": 0.1, "velocity_max": 0.15},
        "domain": domain
    }  # fmt: skip
    walls = {"floor": plane([0, 0, 0], [0, 0, 1])} | more.pop("walls", {})
    return build_scene({"beads": group}, walls=walls, materials=glass, **parts | more)


def test_static_overlap_of_the_weight():
    """p = M g / A; the largest of N = 3 A / d^2 forces is ln(2 N) / 1.5 times the mean pi d^2 p / (0.6 6).

    Between two particles F = 4/3 E* sqrt(R/2) delta^1.5 with E* = E / (2 (1 - nu^2)).
    """
    found = forecast(bed(1e5), "overlap under the weight")
    pressure = 300 * pi / 6 * 0.004**3 * 2500.0 * 9.81 / 0.024**2
    force = log(2 * 3 * 0.024**2 / 0.004**2) / 1.5 * pi * 0.004**2 * pressure / 3.6
    k = 4 / 3 * 1e5 / (2 * (1 - 0.25**2)) * sqrt(0.001)
    assert found.overlap == pytest.approx((force / k) ** (2 / 3) / 0.002, rel=1e-6)
    assert found.warning is None or found.overlap > 0.1


def large_on_small(modulus, ratio=20.0, count=1500, normal="zhou"):
    """A particle of `ratio` mm that falls by 7 mm onto a layer of particles of 1 mm on a floor of 24 mm x 24
    mm."""
    glass = {"glass": {"young_modulus": modulus, "poisson_ratio": 0.25, "density": 2500.0}}
    region = {"box": {"min": [-0.012, -0.012, 0.0], "max": [0.012, 0.012, 0.006]}}
    small = {
        "material": "glass", "count": count, "diameter": 0.001, "insert": {"kind": "pack", "region": region}
    }  # fmt: skip
    large = particle_group([[0.0, 0.0, 0.0005 * ratio + 0.007]], 0.001 * ratio)
    return build_scene(
        {"small": small, "large": large}, walls={"floor": plane([0, 0, 0], [0, 0, 1])}, materials=glass,
        gravity=[0.0, 0.0, -9.81], run={"duration": 0.1, "velocity_max": 0.37}, normal=normal,
        domain={"min": [-0.013, -0.013, -0.001], "max": [0.013, 0.013, 0.06], "on_exit": "error"},
    )  # fmt: skip


@pytest.mark.parametrize("normal", ["zhou", "hertz"])
def test_large_particle_compresses_supported_small_ones(normal):
    """The energy M v^2 / 2 is stored in 2 N contacts, (2/5) k d^2.5 each, N = 0.8 2 R d / r^2 at the limit d
    = 0.1 r.

    In runs of such a scene the largest overlap is 0.46 of the radius at 10 MPa, 0.24 at 60 MPa: 0.6 GPa is
    enough.
    """
    found = forecast(large_on_small(1e7, normal=normal), "overlap of impacts")
    mass = 2500.0 * 4.0 / 3.0 * pi * 0.01**3
    count = 0.8 * 2.0 * 0.01 * 0.1 / 0.0005
    stiffness = 4.0 / 3.0 * 1e7 / (2.0 * (1.0 - 0.25**2)) * sqrt(0.01 * 0.0005 / 0.0105)
    overlap = (1.25 * mass / (2.0 * count) * 0.37**2 / stiffness) ** 0.4 / 0.0005
    assert found.overlap == pytest.approx(overlap, rel=0.01 if normal == "zhou" else 0.25)
    value, unit = re.search(r"young_modulus to ([\d.]+) ([GM])Pa", found.warning).groups()
    advised = float(value) * {"G": 1e9, "M": 1e6}[unit]
    assert 0.6e9 < advised < 1.5e9
    assert warnings_of(large_on_small(advised, normal=normal)) == []


def test_small_particles_that_are_not_supported_are_hit_in_binary_collisions():
    """A bed that is deep for the size of the large particle, and a few small particles do not support it.

    In a run with the ratio 5, the largest overlap is 0.06 of the radius.
    """
    for scene in (
        large_on_small(1e7, ratio=5.0),
        large_on_small(1e7, count=5000),
        large_on_small(1e7, count=3),
    ):
        assert warnings_of(scene) == []


def lid(height=0.1, pressure=1e4, **more):
    motion = {"kind": "servo", "direction": [0, 0, -1], "pressure": pressure, "velocity_max": 0.5} | more
    sides = [[0.024, 0, 0], [0, 0.024, 0]]
    return {
        "lid": {
            "shape": "rectangle", "corner": [0, 0, height], "sides": sides, "material": "glass",
            "motion": motion
        }
    }  # fmt: skip


def test_pressing_wall_is_named_with_its_pressure():
    run = {"duration": 0.2, "velocity_max": 0.15}
    (warning,) = [
        each for each in warnings_of(bed(1e6, walls=lid(pressure=2e5), run=run)) if "static" not in each
    ]
    assert "walls.lid" in warning and "200 kPa" in warning and "materials.glass.young_modulus" in warning
    assert warnings_of(bed(1e9, walls=lid(pressure=2e5), run=run)) == []


def test_overlap_by_cohesion_alone():
    """SJKR balances Hertz where 2 pi w R* d = 4/3 E* sqrt(R*) d^1.5: d = R* (3 pi w / (2 E*))^2, R* = R or
    R/2.

    At a wall the overlap over the radius is 2 times that between particles: (3 pi w / (2 E*))^2 = 0.195 for w
    = 5e4.
    """
    contact = {"normal": "hertz", "tangential": "none", "rolling": "none", "cohesion": "sjkr"}
    pair = {"restitution": 0.5, "cohesion_energy_density": 5e4}
    scene = bed(1e6, pair=pair, contact=contact)
    expected = (1.5 * pi * 5e4 / (1e6 / (2 * (1 - 0.25**2)))) ** 2
    found = forecast(scene, "overlap by cohesion")
    assert found.overlap == pytest.approx(expected, rel=1e-6)
    (warning,) = [each for each in warnings_of(scene) if "an impact" not in each]
    assert "cohesion alone" in warning and "Lower cohesion_energy_density" in warning


BED_DISTANCE = 0.1 - 300 * pi / 6 * 0.004**3 / (0.55 * 0.024**2) - 0.004
"""Distance [m] of a lid at 100 mm from 300 spheres of 4 mm: 31.7 mm high at the solid fraction 0.55, and a
layer."""


def test_servo_that_moves_too_slowly_is_reported_with_a_sufficient_velocity():
    """The lid at 100 mm moves 10 mm in 0.1 s."""
    (warning,) = warnings_of(bed(1e9, walls=lid(pressure=1e5, velocity_max=0.1)))
    assert (
        f"the bed is about {BED_DISTANCE:.3g} m away" in warning
        and "(0.1 m/s, velocity_max, for 0.1 s)" in warning
    )
    assert "translation" not in warning and "target (" not in warning
    advised = float(warning.split("Set velocity_max to ")[1].split(" m/s")[0])
    assert warnings_of(bed(1e9, walls=lid(pressure=1e5, velocity_max=advised))) == []


def test_wall_far_outside_the_domain_is_reported(tmp_path):
    """22 in place of 22 mm: the plate is 22 m above a domain that ends at 30 mm."""
    plate = "{shape: rectangle, corner: [0, 0, 22], sides: [[1 cm, 0, 0], [0, 1 cm, 0]], material: glass}"
    (warning,) = warnings_of(scene_of(tmp_path, f"walls.plate={plate}"))
    assert float(warning.split("is at least ")[1].split(" m outside")[0]) == pytest.approx(22.0, rel=0.01)
    assert warnings_of(scene_of(tmp_path, f"walls.plate={plate.replace('22]', '22 mm]')}")) == []


def test_wall_that_moves_away_is_reported_unless_the_scene_ends_its_motion(tmp_path):
    belt = (
        "{shape: rectangle, corner: [0, 0, 12 mm], sides: [[2 cm, 0, 0], [0, 2 cm, 0]], material: glass, "
        "motion: {kind: translation, velocity: [1 m/s, 0, 0]%s}}"
    )
    (warning,) = warnings_of(scene_of(tmp_path, f"walls.belt={belt % ''}"))
    # The belt leaves the domain, up to x = 3 cm, after 30 ms.
    assert "walls.belt" in warning and 0.03 < float(warning.split("after ")[1].split(" s")[0]) < 0.042
    assert warnings_of(scene_of(tmp_path, f"walls.belt={belt % ', end: 50 ms'}")) == []
    assert warnings_of(scene_of(tmp_path, f"walls.belt={belt % ''}", "run.duration=10 ms")) == []


def test_translation_that_turns_with_the_rotation_before_it_is_reported_with_time_and_distance(tmp_path):
    """A plate of 1 cm around x = 0 moves by 24 mm and makes half a turn in a domain from -10 to 30 mm.

    In space it ends at x = 19 to 29 mm; in its own frame at -(5 + 24) = -29 mm, 19 mm outside.
    """
    plate = (
        "{shape: rectangle, corner: [-5 mm, 5 mm, 12 mm], sides: [[1 cm, 0, 0], [0, 1 cm, 0]], "
        "material: glass, motion: [%s]}"
    )
    turn = "{kind: rotation, axis: [0, 0, 1], point: [0, 10 mm, 0], angular_velocity: 1800 deg/s}"
    shift = "{kind: translation, velocity: [24 cm/s, 0, 0], end: 0.1 s}"
    turned, straight = (
        warnings_of(scene_of(tmp_path, f"walls.plate={plate % order}", "run.duration=0.1"))
        for order in (f"{turn}, {shift}", f"{shift}, {turn}")
    )
    assert len(turned) == 1 and straight == []
    assert "Motion 1 turns with the rotation before it, motion 0" in turned[0]
    reached, at = turned[0].split("by up to ")[1].split(" s. ")[0].split(" m at ")
    assert (float(reached), float(at)) == pytest.approx((0.019, 0.1), rel=0.02)
    far = f"{shift.replace('24', '90')}, {turn}"  # by 9 cm
    found = warnings_of(scene_of(tmp_path, f"walls.plate={plate % far}", "run.duration=0.1"))
    (sentence,) = [each for each in found if "takes parts of the wall out" in each]
    carried = float(sentence.split("motion 1, carry it by up to ")[1].split(" m:")[0])
    assert carried == pytest.approx(0.09, rel=0.02) and "Check the point" not in sentence


PLATE = "{shape: rectangle, corner: [0, 0, 5 mm], sides: [[2 cm, 0, 0], [0, 2 cm, 0]], material: glass}"


def test_particles_of_a_packing_that_overlap_a_wall_are_left_out(tmp_path):
    """Centers of spheres of radius 2 mm overlap a plate at z = 5 mm by more than the limit 0.1 R if they are
    less than 1.8 mm from it; the others remain as they are without the plate.
    """
    packing = "particles.beads.insert.kind=pack"
    all_of_them = initial_particles(scene_of(tmp_path, packing)).position
    plan = plan_for(scene_of(tmp_path, packing, f"walls.plate={PLATE}"))
    particles, _, warnings = initial_state(plan, None, None)
    expected = all_of_them[abs(all_of_them[:, 2] - 5e-3) >= 1.8e-3]
    assert 0 < len(expected) < 10 and (particles.position == expected).all()
    assert len(warnings) == 1 and plan.warnings == ()
    assert (
        f"{10 - len(expected)} of 10 particles are left out because they overlap walls.plate "
        f"({10 - len(expected)}) at the start; {len(expected)} remain. For the full number, multiply its count or mass by "
        f"{10 / len(expected):.3g}," in warnings[0]
    )
    higher = plan_for(scene_of(tmp_path, packing, f"walls.plate={PLATE.replace('5 mm', '10 mm')}"))
    particles, _, warnings = initial_state(higher, None, None)
    assert len(particles) == 10 and warnings == []


@pytest.mark.parametrize(("radius", "most_are_inside"), [("9 mm", True), ("4 mm", False)])
def test_particles_on_both_sides_of_a_container_are_named(tmp_path, radius, most_are_inside):
    """A packing in a square of 2 cm with an open cylinder about its middle: 9 mm enclose 64 % of the area."""
    ends = "from: [1 cm, 1 cm, 0], to: [1 cm, 1 cm, 5 cm]"
    vessel = f"{{shape: cylinder, {ends}, radius: {radius}, material: glass}}"
    beads = [f"particles.beads.{key}" for key in ("count=300", "diameter=1 mm", "insert.kind=pack")]
    box = "particles.beads.insert.region.box={min: [0, 0, 0], max: [2 cm, 2 cm, 2 cm]}"
    plan = plan_for(scene_of(tmp_path, f"walls.vessel={vessel}", *beads, box))
    particles, _, warnings = initial_state(plan, None, None)
    found = [each for each in warnings if "start outside walls.vessel" in each]
    assert len(found) == most_are_inside
    if found:
        everywhere = initial_particles(plan.scene).position
        outside = (np.linalg.norm(everywhere[:, :2] - 0.01, axis=1) > 9e-3).sum()
        assert (
            f": {outside} of 300 particles start outside walls.vessel and {300 - outside} inside." in found[0]
        )


@pytest.mark.parametrize(("size", "center"), [(0.012, 0.01), (0.05, 0.0)])
def test_packing_leaves_out_the_inside_of_a_solid_body_but_not_of_a_container(tmp_path, size, center):
    """A closed cube of 12 mm with space for whole particles of 2 mm inside, and one of 50 mm around all."""
    points, corners = cube()
    write(tmp_path / "body.stl", size * (points - 0.5) + center, corners)
    body = "walls.body={shape: mesh, file: body.stl, material: glass}"
    beads = [f"particles.beads.{key}" for key in ("count=600", "diameter=2 mm", "insert.kind=pack")]
    box = "particles.beads.insert.region.box={min: [0, 0, 0], max: [2 cm, 2 cm, 2 cm]}"
    plan = plan_for(scene_of(tmp_path, body, *beads, box, "walls.floor.point=[0, 0, -1 cm]"))
    particles, _, warnings = initial_state(plan, None, None)
    outside = abs(particles.position - center).max(axis=1) >= 0.5 * size + 0.9e-3
    if size < 0.02:
        corner = abs(particles.position - center).max(axis=1) < 0.5 * size  # near an edge or corner: outside
        assert not corner.any() and 300 < len(particles) < 600 and "overlap walls.body" in warnings[0]
    else:
        assert len(particles) == 600 and warnings == [] and not outside.any()


def test_packing_behind_a_wall_is_refused(tmp_path):
    plan = plan_for(scene_of(tmp_path, "walls.floor.point=[0, 0, 11 mm]"))
    with pytest.raises(
        SceneError, match="has no particle left, because all are inside or behind walls.floor"
    ):
        initial_state(plan, None, None)


@pytest.mark.parametrize(("height", "share"), [(4, None), (6, 96.7)])
def test_rain_that_a_wall_leaves_few_positions_is_reported(tmp_path, height, share):
    """Centers are between z = 2 and 8 mm; a floor at height h [mm] takes those below h + 1.8 mm: 63 or 97 %."""
    rain = "{kind: rain, rate: 100, region: {box: {min: [0, 0, 0], max: [2 cm, 2 cm, 1 cm]}}}"
    floor = f"walls.floor.point=[0, 0, {height} mm]"
    found = warnings_of(scene_of(tmp_path, f"particles.beads.insert={rain}", floor))
    shares = [float(each[1]) for text in found if (each := re.search(r"([0-9.]+) % of the positions", text))]
    assert shares == ([] if share is None else [pytest.approx(share, abs=1.0)])


def test_initial_particles_inside_walls_are_reported():
    inside = particle_group([[0.0, 0.0, 0.05], [0.0, 0.0, 0.003], [0.0, 0.0, 0.0049]])
    scene = build_scene({"balls": inside}, walls={"floor": plane([0, 0, 0], [0, 0, 1])})
    plan = plan_for(scene)
    (warning,) = particle_warnings(plan, initial_particles(scene))
    assert (
        "1 of 3 particles are inside walls.floor at the start, by up to 0.4 of the radius, at [0, 0, 0.003] m"
        in warning
    )


@pytest.mark.parametrize(("distance", "expected"), [(0.00399, 0), (0.0035, 1)])
def test_file_of_a_settled_bed_causes_no_warning(tmp_path, distance, expected):
    """Two particles of radius 2 mm that overlap by 0.5 % of the radius touch; 25 % is more than the weight
    explains."""
    rows = f"x,y,z,r\n0.005,0.005,0.002,0.002\n0.005,{0.005 + distance},0.002,0.002\n"
    (tmp_path / "start.csv").write_text(rows)
    text = TEXT.replace("    count: 10\n    diameter: 4 mm\n", "").replace(
        "young_modulus: 10 MPa", "young_modulus: 10 kPa"
    )
    start, end = text.index("    insert: {kind: lattice"), text.index("domain:")
    text = f"{text[:start]}    insert: {{kind: file, file: start.csv}}\n{text[end:]}"
    found = [
        each
        for each in warnings_of(scene_of(tmp_path, "run.velocity_max=0.01", text=text))
        if "start.csv" in each
    ]
    assert len(found) == expected
    assert all("overlap by up to 0.25 of the smaller radius (lines 2 and 3)" in each for each in found)


@pytest.mark.parametrize(
    ("positions", "distance", "limit", "overlap"),
    [
        ([[0, 0, 0.1], [0, 0, 0.1]], 0.01, 0.1, 2.0),
        ([[0.05, 0, 0], [0, 0, 0], [0, 0.007, 0]], 0.003, 0.1, 0.6),
        ([[0, 0, -0.998], [0, 0, 0.999]], 0.007, 0.1, 1.4),
        ([[0, 0, 0], [0, 0.0099, 0]], None, 0.1, 0.02),
        ([[0, 0, 0], [0, 0.007, 0]], None, 0.7, 0.6),
    ],
    ids=["identical", "overlap", "periodic", "touching", "higher limit"],
)
def test_initial_particles_that_overlap_each_other_are_refused(positions, distance, limit, overlap):
    """Spheres with the radius 5 mm overlap by (2 R - |x_i - x_j|) / R."""
    domain = {"min": [-1.0] * 3, "max": [1.0] * 3, "periodic": ["z"], "on_exit": "error"}
    numerics = {"max_overlap": limit}
    scene = build_scene({"balls": particle_group(positions)}, domain=domain, numerics=numerics)
    if distance is None:
        return refuse_initial_overlaps(scene, initial_particles(scene))
    sentence = (
        f"overlap by {overlap:g} of the smaller radius .* at most {limit:g} is permitted .numerics.max_overlap; .*Move them "
        f"{distance:g} m"
    )
    with pytest.raises(SceneError, match=sentence):
        refuse_initial_overlaps(scene, initial_particles(scene))


@pytest.mark.parametrize("normal", ["hertz", "zhou", {"law": "linear", "stiffness": {"value": 2e3}}])
def test_impact_velocity_follows_from_the_elastic_energy_of_the_model(normal):
    """At half of the largest overlap of an elastic impact at 0.1 m/s, with the approach velocity that remains
    there.

    A linear spring stores k d^2 / 2 (1/4 of the energy at d/2), a Hertz contact 8/15 E* sqrt(R) d^2.5
    (2^-2.5).
    """
    balls = particle_group([[0.0, 0.0, 0.1], [0.0, 0.0, 0.2]])
    plan = plan_for(build_scene({"balls": balls}, normal=normal, pair={"restitution": 1.0}))
    (pair,) = touching_pairs(plan)
    half = 0.5 * pair.overlap_radius * impact_overlap(plan.laws, pair, 0.1)
    stored = 0.25 if isinstance(normal, dict) else 0.5**2.5
    approach = 0.1 * sqrt(1.0 - stored)
    assert impact_velocity(plan.laws, pair, half, approach) == pytest.approx(0.1, rel=1e-3)


REGION = {"box": {"min": [-0.1] * 3, "max": [0.1] * 3}}


def test_insertion_is_reported_if_it_starts_after_the_run_but_not_if_the_run_ends_it():
    """500 particles at 1000 per second from 0.1 s on take 499 ms."""
    insertion = {"kind": "rain", "region": REGION, "rate": 1000.0, "start": 0.1}
    rain = {"material": "glass", "count": 500, "diameter": 0.004, "insert": insertion}
    (warning,) = warnings_of(build_scene({"rain": rain}, run={"duration": 0.1}))
    assert "the insertion starts at 0.1 s, but the run ends at 0.1 s: no particle is inserted" in warning
    assert warnings_of(build_scene({"rain": rain}, run={"duration": 0.3})) == []


TURN = {"kind": "rotation", "axis": [0, 1, 0], "angular_velocity": 1.0, "start": 0.2}


@pytest.mark.parametrize(
    ("key", "parts"),
    [
        ("walls.floor.motion.0", {"walls": {"floor": plane([0, 0, -0.1], [0, 0, 1], motion=TURN | {"point": [0] * 3})}}),
        ("gravity.motion.0", {"gravity": {"vector": [0, 0, -9.81], "motion": TURN}}),
        ("gravity.times", {"gravity": {"times": [0.2, 0.4], "vectors": [[0, 0, -9.81], [0, 0, -1]]}}),
    ],
)  # fmt: skip
def test_motion_that_begins_after_the_run_is_reported(key, parts):
    groups = {"ball": particle_group([[0.0, 0.0, 0.0]], 0.01)}
    (warning,) = warnings_of(build_scene(groups, run={"duration": 0.1, "velocity_max": 1.0}, **parts))
    assert warning.startswith(key) and " begins at 0.2 s, but the run ends at 0.1 s" in warning
    assert warnings_of(build_scene(groups, run={"duration": 0.3, "velocity_max": 1.0}, **parts)) == []


def test_servo_that_its_gain_slows_down_is_reported():
    """Without contacts the servo moves at gain F = 1e-3 m/(s N) * 5.76 N, whatever velocity_max permits.

    At the advised target it moves the distance in the time; an advised duration does as well.
    """
    (warning,) = warnings_of(bed(1e9, walls=lid(gain=1e-3, velocity_max=2.0)))
    speed = 1e-3 * 1e4 * 0.024**2
    assert f"{speed:.3g} m/s, gain times force, less than velocity_max 2 m/s" in warning
    assert "velocity_max to" not in warning and "by a translation" in warning
    target = float(warning.split("target (to ")[1].split(" N")[0])
    assert BED_DISTANCE / 0.1 < 1e-3 * target < 1.3 * BED_DISTANCE / 0.1
    higher = lid(gain=1e-3, velocity_max=2.0, pressure=target / 0.024**2)
    assert not [each for each in warnings_of(bed(1e9, walls=higher)) if "walls.lid.motion" in each]
    seconds = float(warning.split("give it ")[1].split(" s")[0])
    longer = {"duration": seconds, "velocity_max": 0.15}
    assert warnings_of(bed(1e9, walls=lid(gain=1e-3, velocity_max=2.0), run=longer)) == []


@pytest.mark.parametrize("direction", [[0, 0, -1], [1, 0, 0]])
@pytest.mark.parametrize("is_lowered", [True, False])
def test_servos_across_gravity_or_after_another_motion_have_no_forecast(direction, is_lowered):
    walls = lid(velocity_max=0.1, direction=direction)
    servo = walls["lid"]["motion"]
    lowering = {"kind": "translation", "velocity": [0, 0, -0.5], "end": 0.05}
    walls["lid"]["motion"] = [lowering, servo] if is_lowered else [servo]
    is_forecast = direction == [0, 0, -1] and not is_lowered
    found = warnings_of(bed(1e9, walls=walls))
    assert any("the bed is about" in each for each in found) == is_forecast
    assert any("only friction can balance" in each for each in found) == (direction == [1, 0, 0])


def free_lid(**more):
    walls = lid()
    walls["lid"]["motion"] = {"kind": "free", "direction": [0, 0, 1], "mass": 0.05} | more
    return walls


@pytest.mark.parametrize("damping", [0.0, 0.5])
def test_free_wall_that_hits_the_bed_faster_than_planned_is_reported(damping):
    """Without damping with sqrt(2 g s), below the terminal velocity M g / c = 0.98 m/s with it. The advised
    velocity suffices; a shorter stage ends before."""

    def rates(_, now):
        return now[1], 9.81 - damping / 0.05 * now[1]

    def reaches(_, now):
        return now[0] - BED_DISTANCE

    reaches.terminal = True
    fallen = solve_ivp(rates, (0.0, 1.0), (0.0, 0.0), events=reaches, rtol=1e-10)
    speed, time = fallen.y[1, -1], fallen.t[-1]
    run = {"duration": 1.05 * time, "velocity_max": 0.15}
    (warning,) = warnings_of(bed(1e9, walls=free_lid(damping=damping), run=run))
    assert f": the free wall hits the bed with about {speed:.3g} m/s, more than run.velocity_max" in warning
    advised = float(warning.split("set run.velocity_max to ")[1].split(" m/s")[0])
    assert warnings_of(bed(1e9, walls=free_lid(damping=damping), run=run | {"velocity_max": advised})) == []
    slow = run | {"duration": 0.1 * time}
    assert warnings_of(bed(1e9, walls=free_lid(damping=damping), run=slow)) == []


def test_free_wall_that_its_force_takes_out_of_the_domain_is_reported():
    """10 mm to the end of the domain with (F - M g) / M = 4 g in sqrt(2 s / 4 g) = 22.6 ms; a force below all
    weights, of 25 g of particles and 50 g, can be balanced."""
    force = 5.0 * 0.05 * 9.81
    (warning,) = warnings_of(bed(1e9, walls=free_lid(force=force)))
    assert "nothing stops the free wall" in warning and "leaves the domain after 0.0226 s" in warning
    assert warnings_of(bed(1e9, walls=free_lid(force=0.075 * 9.81 - 0.01))) == []
    above = plane([0, 0, 0.108], [0, 0, -1])
    assert warnings_of(bed(1e9, walls=free_lid(force=force) | {"roof": above})) == []


def speed_of_walls(scene):
    return surface_speed(scene, plan_for(scene).walls)


def test_particles_attached_to_a_rotating_wall_count_in_its_speed():
    """w (L + R): L = 30 mm from the axis to the center of the farthest particle, up to the corner of the cube
    around it; in a region, to the farthest corner."""
    turn = {"kind": "rotation", "point": [0, 0, 0], "axis": [0, 0, 1], "angular_velocity": 20.0}
    shaft = {
        "shape": "cylinder", "from": [0, 0, -0.01], "to": [0, 0, 0.01], "radius": 0.005, "material": "glass",
        "motion": turn,
    }  # fmt: skip
    pins = particle_group([[0.01, 0, 0], [0.0, 0.03, 0]], 0.01) | {"fixed": {"to": "shaft"}}
    region = {"box": {"min": [0.0, 0.0, -0.01], "max": [0.03, 0.04, 0.01]}}
    for group, low, high in (
        (pins, 20.0 * 0.035, 20.0 * (0.03 + 0.005 * 2**0.5)),
        (pins | {"insert": {"kind": "lattice", "region": region}, "count": 2}, 20.0 * 0.05, 20.0 * 0.05),
        (None, 20.0 * 0.005, 20.0 * 0.005),
    ):
        groups = {"ball": particle_group([[0.05, 0.05, 0.0]], 0.01)} | ({"pins": group} if group else {})
        speed = speed_of_walls(build_scene(groups, walls={"shaft": shaft}))
        assert low * (1 - 1e-9) <= speed <= high * (1 + 1e-9)


def test_servos_of_different_stages_do_not_add_their_speeds():
    slow, fast = (
        {"kind": "servo", "direction": [0, 0, -1], "force": 1.0, "velocity_max": v} for v in (0.1, 0.3)
    )
    walls = lid()
    stages = {"stages": [{"name": name, "duration": 0.1} for name in ("seat", "press")]}
    walls["lid"]["motion"] = [slow | {"stages": ["seat"]}, fast | {"stages": ["press"]}]
    assert speed_of_walls(bed(1e9, walls=walls, **stages)) == 0.3
    walls["lid"]["motion"] = [slow, fast]
    assert speed_of_walls(bed(1e9, walls=walls, **stages)) == pytest.approx(0.4)


@pytest.mark.parametrize(("changes", "sentence"), [
    ("materials.glass.density=2.5", "materials.glass.density .* is 2.5 kg/m3, less than light foams"),
    ("materials={glass: {young_modulus: 50e6 N/mm2, poisson_ratio: 0.2, density: 2500}, "
     "steel: {young_modulus: 2e6 GPa, poisson_ratio: 0.3, density: 7800}}",
     "young_modulus .* is 5e[+]04 GPa, more than that of diamond"),
    ("pairs.glass-glass.work_of_adhesion=0.1",
     "pairs.glass-glass.work_of_adhesion .* is not used, because contact.cohesion is none; dmt or jkr"),
    ("pairs.glass-glass.friction=30", "pairs.glass-glass.friction .* is 30: it is a coefficient"),
    ("particles.ball={material: glass, diameter: 4, insert: {kind: positions, positions: [[0, 0, 0]]}}",
     "particles.ball.diameter .* is 4 m, 100 times the longest side of the domain"),
    ("expect=[{quantity: angle_of_repose.heap, between: [20, 30]}]",
     "angle_of_repose.heap is in rad, and the bound is 30")
])  # fmt: skip
def test_values_with_a_probably_wrong_unit_are_reported(tmp_path, changes, sentence):
    heap = "output.metrics={heap: {kind: repose, surface: cone}}"
    assert any(re.search(sentence, each) for each in warnings_of(scene_of(tmp_path, heap, changes)))


@pytest.mark.parametrize(("interval", "count"), [("51 ms", 1), ("50 ms", 0)])
def test_plan_reports_an_output_interval_above_the_duration(tmp_path, interval, count):
    plan = plan_for(scene_of(tmp_path, f"output.interval={interval}"))
    assert sum("output.interval" in each and "at most 0.05 s" in each for each in plan.warnings) == count
