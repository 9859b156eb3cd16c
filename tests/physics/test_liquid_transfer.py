"""Liquid films and bridges: shares at formation and rupture, exact conservation, spread of films, messages."""

import math

import numpy as np
import pytest
from clumps import clump_group
from scene_builders import LIQUID, SOFT, build_scene, particle_group, plane, run_and_sample, run_to_end
from scipy.integrate import quad

from granflow.errors import GranflowError, RunError, SceneError
from granflow.geometry.clump import clump_body
from granflow.load import Scene
from granflow.plan.build import plan_for
from granflow.plan.explain import explain
from granflow.runs.read_run import read_run

DIAMETER = 0.004
SPHERE = math.pi / 6.0 * DIAMETER**3
TENSION, ANGLE, CONTENT = 0.072, 0.3, 0.01
UNLIMITED = 1e-8
"""A largest bridge volume [m3] that no bridge reaches."""
FLOOR = {"floor": plane([0, 0, 0], [0, 0, 1])}
ABOVE = 0.1
"""Height [m] of particles that do not touch the floor."""


def wet_scene(groups, walls=FLOOR, max_bridge_volume=UNLIMITED, tension=TENSION, chunk_size=1, **parts):
    """A scene of elastic particles with films on a floor, and a dry fixed particle that nothing touches, the last
    one: such scenes share their kernels."""
    alone = particle_group([[0.5, 0.5, 0.5]], DIAMETER, liquid_content=0.0) | {"fixed": True}
    pair = {"restitution": 1.0, "surface_tension": tension, "contact_angle": ANGLE} | parts.pop("pair", {})
    cohesion = {"law": "capillary_transfer", "max_bridge_volume": max_bridge_volume}
    parts = {
        "contact": {"normal": "hertz", "tangential": "mindlin", "rolling": "none", "cohesion": cohesion},
        "run": {"duration": 0.05, "time_step": 2e-6, "velocity_max": 1.0},
        "output": {"interval": 1.0, "energy_budget": True},
        "numerics": {"chunk_size": chunk_size},
    } | parts
    return build_scene(groups | {"alone": alone}, walls, pair, **parts)


def share(radius, radius_partner):
    """Part of a film that a bridge takes (Shi & McCarthy 2008)."""
    return 0.5 * (1.0 - math.sqrt(1.0 - (radius_partner / (radius + radius_partner)) ** 2))


EQUAL = share(1.0, 1.0)


def approaching(diameters, contents):
    """Two particles 0.02 mm apart; the second approaches along z with 0.2 m/s."""
    heights = (ABOVE, ABOVE + 0.5 * sum(diameters) + 2e-5)
    return {
        name: particle_group(
            [[0.0, 0.0, height]], diameter, velocity=[0.0, 0.0, velocity], liquid_content=content
        )
        for name, height, diameter, velocity, content in zip(
            ("first", "second"), heights, diameters, (0.0, -0.2), contents, strict=True
        )
    }


def liquid(last):
    """All liquid [m3]: films and bridges."""
    return last.totals["liquid_film_volume"] + last.totals["liquid_bridge_volume"]


def work_of_rupture(radius_eff, volume):
    """Work [J] of the force 4 pi R g cos(t) / (1 + 1.05 u + 2.5 u^2), u = s sqrt(2 R / V), up to s = (1 + t/2) V^(1/3)
    (Willett 2000)."""
    scale = math.sqrt(2.0 * radius_eff / volume)
    distance = (1.0 + 0.5 * ANGLE) * volume ** (1.0 / 3.0)
    work = quad(
        lambda s: 1.0 / (1.0 + 1.05 * s * scale + 2.5 * (s * scale) ** 2), 0.0, distance, epsrel=1e-12
    )[0]
    return 4.0 * math.pi * radius_eff * TENSION * math.cos(ANGLE) * work


def films_of(last):
    """Film volumes [m3] in the order of the ids, without the fixed particle."""
    return last.particles["liquid_film"][np.argsort(last.particles["id"])][:-1]


def test_bridge_takes_the_shares_of_both_films_and_returns_halves(taichi_f64, tmp_path):
    """Also in frames and time series, and before, during and after the contact with equal sums."""
    diameters, contents = (0.004, 0.006), (0.002, 0.005)
    output = {"interval": 0.0002, "contacts": True, "energy_budget": True}
    scene = wet_scene(approaching(diameters, contents), output=output)
    films = np.array([c * math.pi / 6.0 * d**3 for d, c in zip(diameters, contents, strict=True)])
    taken = films * [share(*diameters), share(*diameters[::-1])]
    before, _ = run_to_end(scene, 0.00005)
    np.testing.assert_allclose(films_of(before), films, rtol=1e-12)
    touching, _ = run_to_end(scene, 0.0002, out=tmp_path / "out")
    assert touching.totals["contact_count"] == 1
    np.testing.assert_allclose(films_of(touching), films - taken, rtol=1e-12)
    assert touching.totals["liquid_bridge_volume"] == pytest.approx(taken.sum(), rel=1e-12)
    after, _ = run_to_end(scene, 0.02)
    np.testing.assert_allclose(films_of(after), films - taken + 0.5 * taken.sum(), rtol=1e-12)
    assert after.totals["liquid_bridge_volume"] == 0.0
    assert liquid(touching) == liquid(after) == liquid(before)
    run = read_run(tmp_path / "out")
    found = run.frames[-1].particles["liquid_film"]
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found[:2], films_of(touching))
    np.testing.assert_allclose(run.contacts[-1]["cohesion_bridge_volume"], [taken.sum()], rtol=1e-6)
    assert run.timeseries_arrays["liquid_film_volume"][0] == pytest.approx(films.sum(), rel=1e-9)


def test_largest_bridge_volume_limits_both_shares_alike(taichi_f64):
    contents = (0.002, 0.006)
    limit = 3e-12
    films = SPHERE * np.array(contents)
    assert films.sum() * EQUAL > limit
    scene = wet_scene(approaching((DIAMETER, DIAMETER), contents), max_bridge_volume=limit)
    touching, _ = run_to_end(scene, 0.0002)
    assert touching.totals["liquid_bridge_volume"] == pytest.approx(limit, rel=1e-12)
    assert touching.totals["liquid_bridge_volume"] <= limit
    np.testing.assert_allclose(films_of(touching), films - limit * films / films.sum(), rtol=1e-12)
    assert plan_for(scene).laws.range == pytest.approx(
        1.001 * (1.0 + 0.5 * ANGLE) * limit ** (1.0 / 3.0), rel=1e-12
    )


def test_wall_takes_the_share_of_an_equal_sphere_and_returns_all(taichi_f64):
    """At the rupture of the bridge, and if a stage ends the contact because it removes the wall.

    The impact loses the work W of the force from first contact to rupture; the energy budget closes, although the
    force begins and ends within a step.
    """
    falling = particle_group(
        [[0.0, 0.0, 0.5 * DIAMETER + 2e-5]], DIAMETER, velocity=[[0, 0, -0.3]], liquid_content=CONTENT
    )
    rebound = wet_scene({"ball": falling}), 0.0001, 0.02
    resting = particle_group([[0.0, 0.0, 0.5 * DIAMETER - 1e-7]], DIAMETER, liquid_content=CONTENT)
    floor = {"floor": plane([0, 0, 0], [0, 0, 1], stages=["rest"])}
    stages = [{"name": "rest", "duration": 0.001}, {"name": "fall", "duration": 0.001}]
    run = {"time_step": 2e-6, "velocity_max": 1.0}
    removed = wet_scene({"ball": resting}, floor, stages=stages, run=run), 0.0009, 0.002
    for scene, during, end in (rebound, removed):
        touching, _ = run_to_end(scene, during)
        assert touching.totals["wall_contact_count"] == 1
        assert touching.totals["liquid_bridge_volume"] == pytest.approx(CONTENT * SPHERE * EQUAL, rel=1e-12)
        after, _ = run_to_end(scene, end)
        assert after.totals["liquid_bridge_volume"] == 0.0
        assert films_of(after) == pytest.approx([CONTENT * SPHERE], rel=1e-12)
        assert liquid(after) == liquid(touching)
        if during == rebound[1]:
            lost = work_of_rupture(0.5 * DIAMETER, CONTENT * SPHERE * EQUAL)
            assert after.totals["plastic_dissipation"] == pytest.approx(lost, rel=1e-9)
            assert abs(after.totals["energy_error"]) < 1e-4
            speed = math.sqrt(0.3**2 - 2.0 * lost / (SOFT["density"] * SPHERE))
            assert after.particles["velocity"][:, 2].max() == pytest.approx(speed, rel=1e-4)


def test_shaken_bed_conserves_liquid_exactly_and_spreads_it(taichi_f64):
    """The sum of films and bridges is the same number at all times after wet particles at the top have left, and
    bridges lose the work of their rupture.

    Wet and dry particles lie between periodic sides on a vibrating floor. Dry rain takes array entries of the
    deleted particles, but no contacts from their lists. The films of a clump have the content of its volume, in which
    overlapping regions count once, and bridges to other bodies only.
    """
    rng = np.random.default_rng(3)
    lattice = 0.0045 * (np.argwhere(np.ones((5, 5, 4))) + [0.5, 0.5, 0.6])
    is_wet = np.argsort(rng.random(100)) < 33
    groups = {
        name: particle_group(lattice[chosen], 0.004, velocity=rng.normal(0.0, 0.3, (chosen.sum(), 3)),
                             liquid_content=content)
        for name, chosen, content in (("wet", is_wet, 0.02), ("dry", ~is_wet, 0.0))
    }  # fmt: skip
    up = lattice[lattice[:, 2] > 0.015] + [0.0, 0.0, 0.03]
    groups["leaving"] = particle_group(up, 0.004, velocity=[[0.0, 0.0, 2.5]] * 25, liquid_content=CONTENT)
    centers = [[0.0, 0.0, 0.0], [0.0025, 0.0, 0.0], [0.005, 0.0, 0.0]]
    rods = clump_group([[0.011, 0.005, 0.022], [0.011, 0.015, 0.022]], centers, 0.002, liquid_content=CONTENT)
    groups["rods"] = rods
    body = clump_body(tuple(map(tuple, centers)), (0.002,) * 3)
    groups["rain"] = {
        "material": "glass", "count": 10, "diameter": 0.004, "liquid_content": 0.0, "velocity": [0.0, 0.0, -1.0],
        "insert": {"kind": "rain", "region": {"box": {"min": [0.002, 0.002, 0.04], "max": [0.02, 0.02, 0.05]}},
                   "rate": 4000.0, "start": 0.015},
    }  # fmt: skip
    shaken = {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-3, "frequency": 60.0}
    scene = wet_scene(
        groups, {"floor": plane([0, 0, 0], [0, 0, 1], motion=shaken)}, max_bridge_volume=2e-11, tension=0.01,
        pair={"friction": 0.3, "restitution": 0.8}, gravity=[0.0, 0.0, -9.81], chunk_size=16,
        domain={"min": [0, 0, -0.01], "max": [0.0225, 0.0225, 0.06], "periodic": ["x", "y"], "on_exit": "delete"},
        run={"duration": 0.06, "time_step": 4e-6, "velocity_max": 3.0},
    )  # fmt: skip
    snapshots = run_and_sample(scene, 0.002)
    start = liquid(snapshots[0])
    content = (0.02 * 33 + CONTENT * 25) * SPHERE + 2 * CONTENT * body.volume
    assert start == pytest.approx(content, rel=1e-12)
    assert snapshots[0].totals["liquid_bridge_volume"] == 0.0
    film = snapshots[0].particles["liquid_film"][
        snapshots[0].particles["group"] == list(groups).index("rods")
    ]
    np.testing.assert_allclose(film, [CONTENT * body.volume / 3.0] * 6, rtol=1e-12)
    deleted = 25 + 1  # with the fixed particle, which is outside of the domain
    later = [each for each in snapshots if each.totals["deleted_count"] == deleted and each.time > 0.02]
    assert later[-1].totals["inserted_count"] - snapshots[0].totals["inserted_count"] == 10
    totals = {liquid(each) for each in later}
    assert len(later) > 15 and len(totals) == 1
    assert totals.pop() == pytest.approx(start - CONTENT * 25 * SPHERE, rel=1e-12)
    assert len({each.totals["liquid_bridge_volume"] for each in later}) > 15
    last = later[-1]
    assert last.totals["plastic_dissipation"] > 0.0
    assert abs(last.totals["energy_error"]) < 2e-3
    films = last.particles["liquid_film"]
    assert min(each.particles["liquid_film"].min() for each in snapshots) >= 0.0
    assert (films > 0.0).mean() > 0.7 and films.max() < 0.02 * SPHERE


def test_bridges_that_take_more_than_the_film_stop_the_run(taichi_f64):
    """Sixteen fixed particles, which overlap each other, touch one particle in the same step: 16 / 15 of its
    film. Other precisions than f64 do not conserve liquid."""
    angles = 2.0 * np.pi * np.arange(16) / 16
    ring = (DIAMETER - 1e-6) * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], 1)
    fixed = particle_group(ring + [0, 0, ABOVE], DIAMETER, liquid_content=0.0) | {"fixed": True}
    ball = particle_group([[0, 0, ABOVE]], DIAMETER, liquid_content=CONTENT)
    assert 16 * EQUAL > 1.0
    scene = wet_scene({"ring": fixed, "ball": ball})
    with pytest.raises(RunError, match="bridges that form in one step on particle 16 .* take more liquid"):
        run_to_end(scene)
    with pytest.raises(GranflowError, match="capillary_transfer conserves liquid in f64 only"):
        plan_for(scene.with_precision("mixed"))


GROUP = particle_group([[0, 0, 0], [0, 0, 0.1]], liquid_content=0.01)


@pytest.mark.parametrize(("group", "cohesion", "parts", "sentence"), [
    ({}, {}, {}, None),
    ({"liquid_content": None}, {}, {}, "liquid_content is missing: contact.cohesion is capillary_transfer; give the"),
    ({"liquid_content": -0.1}, {}, {}, "liquid_content is -0.1, but a fraction must be at least 0"),
    ({}, {"cohesion": "sjkr"}, {}, "is 0.01, but contact.cohesion is sjkr; remove liquid_content, or choose"),
    ({}, {"cohesion": {"law": "capillary_transfer"}}, {}, "max_bridge_volume is missing: largest volume of a bridge"),
    ({}, {}, {"start_from": "out/earlier"}, "start_from cannot be combined with contact.cohesion: capillary_transfer"),
    ({}, {}, {"run": {"duration": 1.0, "precision": "f32"}}, "is f32, .* conserves liquid in f64 only; write f64."),
])  # fmt: skip
def test_invalid_liquid_is_refused(group, cohesion, parts, sentence):
    scene = build_scene({"wet": GROUP}, **LIQUID).to_dict()
    changed = scene["particles"]["wet"] | group
    scene["particles"]["wet"] = {key: value for key, value in changed.items() if value is not None}
    scene["contact"] |= cohesion
    if sentence is None:
        assert "liquid transfer" in explain(plan_for(Scene.from_dict(scene)))
        return
    with pytest.raises(SceneError, match=sentence):
        plan_for(Scene.from_dict(scene | parts))
