"""Liquid films and bridges: shares at formation and rupture, work of rupture, exact conservation, spread of
films."""

import math

import numpy as np
import pytest
from geometry.meshes import sheet, write
from scene_builders import (
    build_scene,
    column,
    particle_group,
    plane,
    run_and_sample,
    run_to_end,
    vibrating_box,
)
from scipy.integrate import quad

from granflow.errors import GranflowError, RunError
from granflow.plan.build import plan_for
from granflow.runs.read_run import read_run

DIAMETER, DENSITY = 0.004, 2500.0
MASS, SPHERE = DENSITY * math.pi / 6.0 * DIAMETER**3, math.pi / 6.0 * DIAMETER**3
TENSION, ANGLE, CONTENT = 0.072, 0.3, 0.01
UNLIMITED = 1e-8
"""A largest bridge volume [m3] that no bridge reaches."""


def wet_scene(groups, walls=None, max_bridge_volume=UNLIMITED, tension=TENSION, numerics=None, **parts):
    """A scene of elastic particles with films, without gravity."""
    pair = {"restitution": 1.0, "surface_tension": tension, "contact_angle": ANGLE} | parts.pop("pair", {})
    cohesion = {"law": "capillary_transfer", "max_bridge_volume": max_bridge_volume}
    contact = {"normal": "hertz", "tangential": "mindlin", "rolling": "none", "cohesion": cohesion}
    parts = {
        "run": {"duration": 0.05, "time_step": 2e-6, "velocity_max": 1.0},
        "output": {"interval": 1.0, "energy_budget": True},
    } | parts
    return build_scene(groups, walls, pair, contact=contact, numerics=numerics or {"chunk_size": 1}, **parts)


def share(radius, radius_partner):
    """Part of a film that a bridge takes (Shi & McCarthy 2008)."""
    return 0.5 * (1.0 - math.sqrt(1.0 - (radius_partner / (radius + radius_partner)) ** 2))


def approaching(diameters, contents, speed=0.2):
    """Two particles 0.02 mm before; the second approaches along z."""
    distance = 0.5 * sum(diameters) + 2e-5
    first = particle_group([[0.0, 0.0, 0.0]], diameters[0], liquid_content=contents[0])
    second = particle_group(
        [[0.0, 0.0, distance]], diameters[1], velocity=[[0, 0, -speed]], liquid_content=contents[1]
    )
    return {"first": first, "second": second}


def liquid(last):
    """All liquid [m3]: films and bridges."""
    return last.totals["liquid_film_volume"] + last.totals["liquid_bridge_volume"]


@pytest.mark.parametrize("chunk_size", [1, 8])
def test_bridge_takes_the_shares_of_both_films_and_returns_halves(taichi_f64, chunk_size):
    diameters = (0.004, 0.006)
    contents = (0.002, 0.005)
    scene = wet_scene(approaching(diameters, contents), numerics={"chunk_size": chunk_size})
    films = np.array([c * math.pi / 6.0 * d**3 for d, c in zip(diameters, contents, strict=True)])
    taken = films * [share(*diameters), share(*diameters[::-1])]
    before, _ = run_to_end(scene, 0.00005)
    np.testing.assert_allclose(before.particles["liquid_film"], films, rtol=1e-12)
    touching, _ = run_to_end(scene, 0.0002)
    assert touching.totals["contact_count"] == 1
    np.testing.assert_allclose(touching.particles["liquid_film"], films - taken, rtol=1e-12)
    assert touching.totals["liquid_bridge_volume"] == pytest.approx(taken.sum(), rel=1e-12)
    after, _ = run_to_end(scene)
    np.testing.assert_allclose(after.particles["liquid_film"], films - taken + 0.5 * taken.sum(), rtol=1e-12)
    assert after.totals["liquid_bridge_volume"] == 0.0
    assert liquid(touching) == liquid(after) == liquid(before)


def test_largest_bridge_volume_limits_both_shares_alike(taichi_f64):
    contents = (0.002, 0.006)
    limit = 3e-12
    films = SPHERE * np.array(contents)
    assert films.sum() * share(1.0, 1.0) > limit
    scene = wet_scene(approaching((DIAMETER, DIAMETER), contents), max_bridge_volume=limit)
    touching, _ = run_to_end(scene, 0.0002)
    assert touching.totals["liquid_bridge_volume"] == pytest.approx(limit, rel=1e-12)
    assert touching.totals["liquid_bridge_volume"] <= limit
    np.testing.assert_allclose(
        touching.particles["liquid_film"], films - limit * films / films.sum(), rtol=1e-12
    )
    assert plan_for(scene).laws.range == pytest.approx(
        1.001 * (1.0 + 0.5 * ANGLE) * limit ** (1.0 / 3.0), rel=1e-12
    )


def test_wall_takes_the_share_of_an_equal_sphere_and_returns_all(taichi_f64):
    falling = particle_group(
        [[0.0, 0.0, 0.5 * DIAMETER + 2e-5]], DIAMETER, velocity=[[0, 0, -0.3]], liquid_content=CONTENT
    )
    scene = wet_scene({"ball": falling}, {"floor": plane([0, 0, 0], [0, 0, 1])})
    touching, _ = run_to_end(scene, 0.0001)
    assert touching.totals["wall_contact_count"] == 1
    expected = CONTENT * SPHERE * share(1.0, 1.0)
    assert touching.totals["liquid_bridge_volume"] == pytest.approx(expected, rel=1e-12)
    after, _ = run_to_end(scene)
    assert after.totals["liquid_bridge_volume"] == 0.0
    assert after.particles["liquid_film"][0] == pytest.approx(CONTENT * SPHERE, rel=1e-12)
    assert liquid(after) == liquid(touching)


def test_wet_particle_shares_geometrically_with_dry_ones_that_touch_it_in_turn(taichi_f64):
    """Dry particles hit a fixed wet one: L (1 - f)^n with f half of the share of the film, the rest to each
    in turn."""
    directions = np.concatenate([np.eye(3), -np.eye(3)])
    gaps = 1e-4 + 1e-3 * np.arange(6)
    dry = particle_group(
        (DIAMETER + gaps)[:, None] * directions, DIAMETER, velocity=-0.5 * directions, liquid_content=0.0
    )
    wet = particle_group([[0, 0, 0]], DIAMETER, liquid_content=CONTENT) | {"fixed": True}
    last, _ = run_to_end(wet_scene({"wet": wet, "dry": dry}, tension=1e-3, numerics={"chunk_size": 4}))
    assert last.totals["liquid_bridge_volume"] == 0.0
    film = CONTENT * SPHERE
    part = 0.5 * share(1.0, 1.0)
    order = np.argsort(last.particles["id"])
    expected = [film * (1.0 - part) ** 6, *(film * (1.0 - part) ** n * part for n in range(6))]
    np.testing.assert_allclose(last.particles["liquid_film"][order], expected, rtol=1e-12)


def rupture_work(volume, radius_eff):
    """Integral of the capillary force [J] up to the rupture distance (Willett 2000, Lian 1993)."""

    def force(distance):
        u = distance * math.sqrt(2.0 * radius_eff / volume)
        return 4.0 * math.pi * radius_eff * TENSION * math.cos(ANGLE) / (1.0 + 1.05 * u + 2.5 * u * u)

    return quad(force, 0.0, (1.0 + 0.5 * ANGLE) * volume ** (1.0 / 3.0), epsrel=1e-10)[0]


@pytest.mark.parametrize("chunk_size", [1, 8])
@pytest.mark.parametrize("over_sticking", [0.98, 1.02, 2.0])
def test_impact_loses_the_work_of_rupture_of_the_volume_that_formed(taichi_f64, chunk_size, over_sticking):
    """Rebound sqrt(v^2 - 2 W / M); below sqrt(2 W / M) the particles stick.

    The bridge forms at the end of the step in which the particles touch, so that W has an error below F v dt.
    """
    volume = 2.0 * CONTENT * SPHERE * share(1.0, 1.0)
    work = rupture_work(volume, 0.25 * DIAMETER)
    speed = over_sticking * math.sqrt(2.0 * work / (0.5 * MASS))
    groups = approaching((DIAMETER, DIAMETER), (CONTENT, CONTENT), speed)
    last, _ = run_to_end(wet_scene(groups, numerics={"chunk_size": chunk_size}), 0.02)
    velocity = last.particles["velocity"][np.argsort(last.particles["id"]), 2]
    touching_force = math.pi * DIAMETER * TENSION * math.cos(ANGLE)
    lost = last.totals["plastic_dissipation"]
    assert work * (1.0 - 1e-9) <= lost <= work + touching_force * speed * 2e-6
    assert abs(last.totals["energy_error"]) < 1e-3
    if over_sticking < 1.0:
        assert last.totals["liquid_bridge_volume"] == pytest.approx(volume, rel=1e-12)
    else:
        assert last.totals["liquid_bridge_volume"] == 0.0
        rebound_squared = speed**2 - 2.0 * lost / (0.5 * MASS)
        assert (velocity[1] - velocity[0]) ** 2 == pytest.approx(
            rebound_squared, rel=0.0, abs=1e-3 * speed**2
        )


def shaken_box(duration=0.4, **parts):
    """216 particles, a quarter of them wet, in a vibrating box."""
    rng = np.random.default_rng(3)
    positions = 0.0048 * (np.argwhere(np.ones((6, 6, 6))) + 0.7)
    wet = np.argsort(rng.random(len(positions))) < len(positions) // 4
    groups = {
        name: particle_group(positions[chosen], DIAMETER, velocity=rng.normal(0.0, 0.3, (chosen.sum(), 3)),
                             liquid_content=content)
        for name, chosen, content in (("wet", wet, 0.02), ("dry", ~wet, 0.0))
    }  # fmt: skip
    walls = vibrating_box(0.031)
    walls["low_z"]["motion"]["amplitude"] = 2e-3
    parts = {
        "pair": {"friction": 0.3, "restitution": 0.8}, "gravity": [0.0, 0.0, -9.81], "numerics": {"chunk_size": 32},
        "tension": 0.01, "run": {"duration": duration, "time_step": 4e-6, "velocity_max": 2.0},
    } | parts  # fmt: skip
    return wet_scene(groups, walls, max_bridge_volume=2e-11, **parts)


def test_shaken_box_conserves_liquid_exactly_and_spreads_it(taichi_f64):
    """The sum of films and bridges is the same number at all times, over thousands of ruptures."""
    snapshots = run_and_sample(shaken_box(), 0.002, contacts=True)
    totals = np.array([liquid(snapshot) for snapshot in snapshots])
    assert (totals == totals[0]).all()
    assert totals[0] == pytest.approx(54 * 0.02 * SPHERE, rel=1e-12)
    films = column(snapshots, "liquid_film")
    assert films.min() >= 0.0
    pairs = [bridged_pairs(snapshot) for snapshot in snapshots]
    ended = sum(len(before - now) for before, now in zip(pairs, pairs[1:], strict=False))
    assert ended > 2000, "a lower bound of the number of ruptures"
    spread = films.std(axis=1) / films.mean(axis=1)
    assert spread[-1] < 0.7 * spread[0]
    assert (films[-1] > 0.0).all(), "all particles are wet"


def bridged_pairs(snapshot):
    """Ids, or walls, of the overlapping contacts that have a bridge."""
    contacts = snapshot.contacts
    has_bridge = contacts["cohesion_bridge_volume"] > 0.0
    return set(zip(*(contacts[name][has_bridge].tolist() for name in ("id_i", "id_j", "wall")), strict=True))


def test_bits_do_not_depend_on_chunk_size_and_skin(taichi_f64):
    one, *others = (
        by_id(run_to_end(shaken_box(0.05, numerics=numerics))[0])
        for numerics in (
            {"chunk_size": 32},
            {"chunk_size": 1},
            {"chunk_size": 7},
            {"chunk_size": 32, "skin": 3e-4},
        )
    )
    assert one["bridges"] > 0.0
    for other in others:
        for name, values in one.items():
            np.testing.assert_array_equal(other[name], values)


def by_id(last):
    """Positions, velocities and films in the order of the ids, and the volume of the bridges."""
    order = np.argsort(last.particles["id"])
    arrays = {name: last.particles[name][order] for name in ("position", "velocity", "liquid_film")}
    return arrays | {"bridges": last.totals["liquid_bridge_volume"]}


def test_liquid_is_conserved_exactly_across_periodic_faces_with_wide_sizes_and_fixed_particles(taichi_f64):
    rng = np.random.default_rng(5)
    positions = 0.005 * (np.argwhere(np.ones((7, 7, 5))) + 0.5)
    small = particle_group(
        positions, 0.003, velocity=rng.normal(0.0, 0.5, positions.shape), liquid_content=0.02
    )
    large = particle_group([[0.018, 0.018, 0.036]], 0.015, velocity=[[0.0, 0.0, -1.0]], liquid_content=0.001)
    row = particle_group([[0.004 * k + 0.002, 0.018, 0.05] for k in range(9)], 0.0039, liquid_content=0.0)
    scene = wet_scene(
        {"small": small, "large": large, "row": row | {"fixed": True}}, max_bridge_volume=1e-11, tension=0.01,
        pair={"friction": 0.3, "restitution": 0.8}, numerics={"chunk_size": 16},
        domain={"min": [0.0] * 3, "max": [0.036, 0.036, 0.06], "periodic": ["x", "y", "z"], "on_exit": "error"},
        run={"duration": 0.03, "time_step": 2e-6, "velocity_max": 3.0},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 0.001)
    totals = [liquid(snapshot) for snapshot in snapshots]
    content = 245 * 0.02 * 0.003**3 + 0.001 * 0.015**3
    assert totals[0] == pytest.approx(math.pi / 6.0 * content, rel=1e-12)
    assert set(totals) == {totals[0]}
    films = column(snapshots, "liquid_film")
    assert films.min() >= 0.0 and (films[-1, -9:] > 0.0).any(), "fixed particles get liquid"
    assert len({snapshot.totals["liquid_bridge_volume"] for snapshot in snapshots}) > 10


@pytest.mark.parametrize("chunk_size", [1, 16])
def test_dry_rain_in_the_place_of_deleted_particles_brings_no_liquid(taichi_f64, chunk_size):
    """Inserted particles take array entries of deleted ones, but no contacts from their lists."""
    rng = np.random.default_rng(7)
    positions = 0.0045 * (np.argwhere(np.ones((4, 4, 6))) + 0.6)
    up = positions[:, 2] > 0.015
    bed = particle_group(
        positions[~up], DIAMETER, velocity=rng.normal(0.0, 0.3, ((~up).sum(), 3)), liquid_content=CONTENT
    )
    leaving = particle_group(
        positions[up], DIAMETER, velocity=[[0.0, 0.0, 2.0]] * int(up.sum()), liquid_content=CONTENT
    )
    region = {"box": {"min": [0.002, 0.002, 0.03], "max": [0.017, 0.017, 0.037]}}
    insertion = {"kind": "rain", "region": region, "rate": 4000.0, "start": 0.012}
    rain = {
        "material": "glass",
        "count": 40,
        "diameter": DIAMETER,
        "liquid_content": 0.0,
        "insert": insertion,
    }
    walls = {name: wall for name, wall in vibrating_box(0.019).items() if name != "high_z"}
    scene = wet_scene(
        {"leaving": leaving, "bed": bed, "rain": rain}, walls, max_bridge_volume=2e-11, tension=0.01,
        pair={"friction": 0.3, "restitution": 0.8}, gravity=[0.0, 0.0, -9.81], numerics={"chunk_size": chunk_size},
        domain={"min": [-0.01] * 3, "max": [0.03, 0.03, 0.04], "on_exit": "delete"},
        run={"duration": 0.05, "time_step": 4e-6, "velocity_max": 3.0},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 0.001)
    assert (
        snapshots[-1].totals["deleted_count"] == up.sum() and snapshots[-1].totals["inserted_count"] > 96 + 10
    )
    after = [liquid(snapshot) for snapshot in snapshots if snapshot.totals["deleted_count"] == up.sum()]
    assert len(after) > 30 and set(after) == {after[0]}
    assert after[0] < 96 * CONTENT * SPHERE


def test_frames_and_time_series_contain_films_and_bridges(taichi_f64, tmp_path):
    scene = wet_scene(
        approaching((DIAMETER, DIAMETER), (CONTENT, 0.0)), output={"interval": 0.0002, "contacts": True},
        run={"duration": 0.0002, "time_step": 2e-6, "velocity_max": 1.0},
    )  # fmt: skip
    run_to_end(scene, out=tmp_path / "out")
    run = read_run(tmp_path / "out")
    taken = CONTENT * SPHERE * share(1.0, 1.0)
    frame = run.frames[-1]
    assert frame.particles["liquid_film"].dtype == np.float64
    np.testing.assert_allclose(frame.particles["liquid_film"], [CONTENT * SPHERE - taken, 0.0], rtol=1e-12)
    np.testing.assert_allclose(run.contacts[-1]["cohesion_bridge_volume"], [taken], rtol=1e-6)
    series = run.timeseries_arrays
    assert series["liquid_film_volume"][0] == pytest.approx(CONTENT * SPHERE, rel=1e-9)
    assert series["liquid_bridge_volume"][-1] == pytest.approx(taken, rel=1e-9)


def test_removed_wall_returns_the_liquid_of_its_bridges(taichi_f64):
    resting = particle_group([[0.0, 0.0, 0.5 * DIAMETER - 1e-7]], DIAMETER, liquid_content=CONTENT)
    floor = plane([0, 0, 0], [0, 0, 1], stages=["rest"])
    stages = [{"name": "rest", "duration": 0.001}, {"name": "fall", "duration": 0.001}]
    scene = wet_scene({"ball": resting}, {"floor": floor}, stages=stages, run={"time_step": 2e-6, "velocity_max": 1.0},
                      gravity=[0.0, 0.0, -9.81])  # fmt: skip
    before, _ = run_to_end(scene, 0.0009)
    after, _ = run_to_end(scene)
    assert before.totals["liquid_bridge_volume"] > 0.0
    assert after.totals["liquid_bridge_volume"] == 0.0
    assert liquid(after) == liquid(before)


def test_bridge_moves_with_the_contact_to_the_next_triangle_of_a_mesh(taichi_f64, tmp_path, monkeypatch):
    """A particle that slides along a floor keeps the volume of its bridge across edges, as on a plane."""
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "sheet.stl", *sheet(8, 0.02))
    mesh = {"shape": "mesh", "file": "sheet.stl", "material": "glass"}
    sliding = particle_group([[0.001, -0.0012, 0.5 * DIAMETER - 1e-7]], DIAMETER, velocity=[[0.0, 0.3, 0.0]],
                             liquid_content=CONTENT)  # fmt: skip
    found = []
    for wall in (plane([0, 0, 0], [0, 0, 1]), mesh):
        last, _ = run_to_end(wet_scene({"ball": sliding}, {"floor": wall}), 0.02)
        assert last.particles["position"][0, 1] > 0.004, "it has crossed edges"
        found.append((last.totals["liquid_bridge_volume"], last.particles["liquid_film"][0]))
    assert found[0][0] == pytest.approx(CONTENT * SPHERE * share(1.0, 1.0), rel=1e-12)
    assert found[1] == found[0]


def test_bridges_that_take_more_than_the_film_stop_the_run(taichi_f64):
    """Sixteen fixed particles, which overlap each other, touch one particle in the same step: 16 / 15 of its
    film."""
    angles = 2.0 * np.pi * np.arange(16) / 16
    ring = (DIAMETER - 1e-6) * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], 1)
    fixed = particle_group(ring, DIAMETER, liquid_content=0.0) | {"fixed": True}
    ball = particle_group([[0, 0, 0]], DIAMETER, liquid_content=CONTENT)
    assert 16 * share(1.0, 1.0) > 1.0
    with pytest.raises(
        RunError, match="the bridges that form in one step on particle 16 .* take more liquid"
    ):
        run_to_end(wet_scene({"ring": fixed, "ball": ball}, numerics={"chunk_size": 4}))


def test_lower_precision_is_refused():
    scene = wet_scene(approaching((DIAMETER, DIAMETER), (0.0, 0.0)))
    with pytest.raises(
        GranflowError, match="contact.cohesion: capillary_transfer conserves liquid in f64 only"
    ):
        plan_for(scene.with_precision("mixed"))
