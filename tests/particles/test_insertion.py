"""Rain and inlets: due particles are inserted without overlap as soon as space is free, and reproducibly."""

from math import inf

import numpy as np
import pytest
from particles.scenes import UNIFORM, clearance, scene_with, smallest_gap

from granflow.errors import SceneError
from granflow.load import scene_of
from granflow.particles.group import groups_of
from granflow.particles.insertion import Inserter, inserters

REGION = {"cylinder": {"from": [0, 0, 0.4], "to": [0, 0, 0.46], "radius": 0.08}}


def rain_of(count=8000, rate=8000.0, start=0.0, diameter=UNIFORM, region=REGION, seed=1):
    """The inserter of a group that rains into a region."""
    insertion = {"kind": "rain", "region": region, "rate": rate, "start": start}
    group = {"count": count, "diameter": diameter, "velocity": [0, 0, -0.5], "insert": insertion}
    still = {"diameter": 0.004, "insert": {"kind": "positions", "positions": [[0, 0, 0]]}}
    return Inserter(groups_of(scene_with({"still": still, "rain": group}, seed))["rain"])


def falling_height(inserted_at, height, now):
    """Heights of freely falling particles without contacts, from the insertion height down to 0."""
    age = now - inserted_at
    return np.maximum(height - 0.5 * age - 0.5 * 9.81 * age**2, 0.0)


def insert_all(rain, batch_count_max=2000):
    """Insert all particles of a group while inserted particles fall: (time, particles) of each batch.

    Checks each batch for overlaps.
    """
    inserted_at = np.empty(0)
    origin = np.empty((0, 3))
    radius = np.empty(0)
    batches = []
    while rain.remaining and len(batches) < batch_count_max:
        now = rain.next_time
        position = origin.copy()
        position[:, 2] = falling_height(inserted_at, origin[:, 2], now)
        particles = rain.insert_due(now, position, radius)
        batches.append((now, particles))
        assert smallest_gap(particles.position, particles.radius) >= -1e-12
        separation = np.linalg.norm(particles.position[:, None] - position, axis=2)
        assert (separation - particles.radius[:, None] - radius).min(initial=inf) >= -1e-12
        inserted_at = np.concatenate([inserted_at, np.full(len(particles), now)])
        origin = np.concatenate([origin, particles.position])
        radius = np.concatenate([radius, particles.radius])
    return batches


def test_all_particles_are_inserted_on_time_without_overlap():
    rain = rain_of(count=2000, rate=4000.0, start=0.1)
    batches = insert_all(rain)
    assert rain.remaining == 0 and rain.next_time == inf
    count = sum(len(particles) for _, particles in batches)
    assert count == 2000
    inserted = 0
    for now, particles in batches:
        inserted += len(particles)
        due = (now - 0.1) * 4000 + 1
        assert due - 5 * rain.batch <= inserted <= due + 1e-6
    assert batches[0][0] == 0.1
    assert batches[-1][0] == pytest.approx(0.1 + 1999 / 4000, abs=5 * rain.batch / 4000)
    assert (
        min(
            clearance(REGION, particles.position, particles.radius)
            for _, particles in batches
            if len(particles)
        )
        >= -1e-12
    )
    inserted_radius = np.sort(np.concatenate([particles.radius for _, particles in batches]))
    np.testing.assert_array_equal(inserted_radius, np.sort(rain.radius))


def test_insertion_is_reproducible_and_depends_on_the_seed():
    first, again, other = (insert_all(rain_of(count=300, seed=seed)) for seed in (1, 1, 2))
    for (now, particles), (then, duplicate) in zip(first, again, strict=True):
        assert now == then
        np.testing.assert_array_equal(particles.position, duplicate.position)
        np.testing.assert_array_equal(particles.radius, duplicate.radius)
    particles = first[0][1]
    assert not np.any(particles.position == other[0][1].position)
    assert np.all(particles.velocity == [0, 0, -0.5])
    assert set(particles.group) == {1} and set(particles.material) == {1}


def test_a_position_is_clear_from_the_sum_of_both_radii():
    """Radii of 2 and 4 mm are 6 mm apart: 5.9 mm is too near, also for the smaller one."""
    rain = rain_of(count=2)
    rain.radius = np.array([0.002, 0.004])
    for k, other in ((0, 1), (1, 0)):
        positions = {other: np.zeros(3)}
        rain.place_first_clear(k, np.array([[0.0059, 0, 0], [0.0061, 0, 0]]), positions)
        np.testing.assert_array_equal(positions[k], [0.0061, 0, 0])


@pytest.mark.parametrize("count", [50, 11])
def test_due_particles_are_queued_while_the_region_is_full(count):
    """While a particle fills the region, nothing is inserted; after its removal all queued particles are
    inserted, also those that wait after the last one has become due."""
    rain = rain_of(count=count, rate=1000.0, diameter=0.004)
    plug = np.array([[0, 0, 0.43]]), np.array([0.2])
    for now in (0.0, 0.005, 0.01):
        assert len(rain.insert_due(now, *plug)) == 0
    assert rain.remaining == count and list(rain.queued) == list(range(11))
    assert 0.01 < rain.next_time < 1.0
    inserted = 0
    while rain.remaining:
        inserted += len(rain.insert_due(rain.next_time, np.empty((0, 3)), np.empty(0)))
    assert inserted == count


def test_insertion_stops_in_a_full_region():
    """Inserted particles stay in place: random insertion fills the region, then inserts no more particles."""
    rain = rain_of(count=4000, rate=1e5, diameter=0.008)
    position = np.empty((0, 3))
    radius = np.empty(0)
    for _ in range(100):
        particles = rain.insert_due(rain.next_time, position, radius)
        position = np.concatenate([position, particles.position])
        radius = np.concatenate([radius, particles.radius])
    assert smallest_gap(position, radius) >= -1e-12
    assert rain.remaining == 4000 - len(radius) > 0


def test_queued_particles_are_given_up_at_the_end():
    """800 particles of 2 to 4 mm are due in 10 ms; a part of them is queued, and nothing enters after the end."""
    insertion = {"kind": "rain", "region": REGION, "rate": 80000.0, "end": 0.01}
    scene = scene_with({"rain": {"diameter": UNIFORM, "insert": insertion}})
    (rain,) = inserters(scene)
    existing = np.random.default_rng(1).uniform([-0.08, -0.08, 0.4], [0.08, 0.08, 0.46], (4000, 3))
    while rain.next_time < inf:
        assert rain.next_time <= 0.01 + 1e-9
        rain.insert_due(rain.next_time, existing, np.full(4000, 0.008))
    assert rain.due_count == 800 and len(rain.queued) > 0
    assert rain.is_over and not rain.is_pending


def test_particles_larger_than_the_region_are_rejected():
    insertion = {"kind": "rain", "region": REGION, "rate": 1.0}
    with pytest.raises(SceneError, match=r"particles\.wide\.count is 3, but none fits in its region"):
        inserters(scene_with({"wide": {"count": 3, "diameter": 0.07, "insert": insertion}}))


def test_each_group_has_an_inserter_with_independent_positions():
    insertion = {"kind": "rain", "region": REGION, "rate": 1.0}
    groups = {name: {"count": 3, "diameter": 0.004, "insert": insertion} for name in ("first", "second")}
    found = inserters(scene_with(groups))
    assert [each.group_name for each in found] == ["first", "second"]
    positions = [each.insert_due(0.0, np.empty((0, 3)), np.empty(0)).position for each in found]
    assert not np.any(positions[0] == positions[1])


def inserter_with(insertion, **group):
    """The inserter of a resolved scene, with glass particles of 2500 kg/m3."""
    given = {"diameter": UNIFORM, "insert": insertion} | group
    still = {"diameter": 0.004, "insert": {"kind": "positions", "positions": [[0, 0, 0]]}}
    return Inserter(groups_of(scene_with({"still": still, "stream": given}))["stream"])


def test_mass_flow_is_exact_within_one_particle():
    """0.4 kg/s for 0.5 s: after every batch the inserted mass is exact within the mass of one particle."""
    insertion = {"kind": "rain", "region": REGION, "mass_flow": 0.4, "start": 0.1, "end": 0.6}
    inserter = inserter_with(insertion)
    heaviest = 4 / 3 * np.pi * 0.0025**3 * 2500
    inserted_mass = 0.0
    for now, particles in insert_all(inserter):
        assert not len(inserter.queued)
        inserted_mass += float((4 / 3 * np.pi * particles.radius**3 * 2500).sum())
        assert 0.0 <= inserted_mass - 0.4 * (now - 0.1) <= heaviest * (1 + 1e-9)
    assert inserted_mass == pytest.approx(0.4 * 0.5, abs=heaviest)
    assert inserter.remaining == 0 and inserter.due_at[-1] < 0.6


def test_size_classes_keep_their_fractions_during_insertion():
    """Masses 1 : 1 : 2 in diameters of 2, 3 and 4 mm, so the numbers are 1/8 : 1/27 : 2/64.

    Particle j of a class with the share s is at the place (j + 1/2) / s of the sequence. Each of the three
    classes deviates by at most 1/2 particle at a given place, the place deviates by at most 3/2 insertions,
    and the count of a class by at most 1/2 + 3/2 s.
    """
    number = np.arange(1, 1001)
    parts = {0.002: 1 / 8, 0.003: 1 / 27, 0.004: 2 / 64}
    classes = [{"diameter": d, "fraction": f} for d, f in zip(parts, (1, 1, 2), strict=True)]
    sizes = {"distribution": "classes", "by": "mass", "classes": classes}
    inserter = inserter_with({"kind": "rain", "region": REGION, "rate": 1000.0}, diameter=sizes, count=1000)
    for diameter, part in parts.items():
        inserted = np.cumsum(np.isclose(2 * inserter.radius, diameter))
        share = part / sum(parts.values())
        assert abs(inserted[-1] - 1000 * share) < 1
        assert np.abs(inserted - share * number).max() <= 0.5 + 1.5 * share


@pytest.mark.parametrize("flow", [{"rate": 40.0, "start": 0.5}, {"mass_flow": 2e-3}])
def test_flow_without_count_lasts_as_long_as_the_run(flow):
    """The run of `scene_with` lasts 1 s. If it is extended to 3 s, the first particles are the same."""
    sizes = {
        "distribution": "classes",
        "by": "number",
        "classes": [{"diameter": d, "fraction": d} for d in (0.003, 0.004)],
    }
    group = {"diameter": sizes, "insert": {"kind": "rain", "region": REGION} | flow}
    scene = scene_with({"rain": group})
    (short,) = inserters(scene)
    insert_all(short)
    expected = 20 if "rate" in flow else pytest.approx(2e-3 / short.mass.mean(), abs=1.0)
    assert short.is_inserted.sum() == expected and short.remaining == 0
    (longer,) = inserters(scene_of(scene.to_yaml(), "resumed", ["run.duration=3 s"]))
    before = len(short.radius)
    for name in ("radius", "due_at"):
        np.testing.assert_array_equal(getattr(longer, name)[:before], getattr(short, name))
    longer.load_state_dict(short.state_dict())
    assert short.due_at[-1] < longer.next_time < short.due_at[-1] + 2 * longer.batch * longer.interval
    insert_all(longer)
    assert longer.remaining == 0 and 2.9 < longer.due_at[-1] < 3.0


@pytest.mark.parametrize(
    ("face", "normal", "center"),
    [
        (
            {"disc": {"center": [0.1, 0, 0.2], "normal": [3, 0, -4], "radius": 0.03}},
            [0.6, 0, -0.8],
            [0.1, 0, 0.2],
        ),
        (
            {"rectangle": {"corner": [0, 0, 0.2], "sides": [[0, 0.06, 0], [0.05, 0, 0]]}},
            [0, 0, -1],
            [0.025, 0.03, 0.2],
        ),
    ],
)
def test_inlet_inserts_whole_particles_behind_its_face(face, normal, center):
    """The depth is at most the distance at 1 m/s between two batches: 1000 at 5000 /s in 500 batches of 0.4
    ms."""
    insertion = {"kind": "inlet", "face": face, "rate": 5000.0}
    inserter = inserter_with(insertion, count=1000, velocity=normal)
    position = np.empty((0, 3))
    radius = np.empty(0)
    batches = []
    now = 0.0
    while inserter.remaining:
        step = inserter.next_time - now
        now = inserter.next_time
        position = position + step * np.array(normal)
        particles = inserter.insert_due(now, position, radius)
        position = np.concatenate([position, particles.position])
        radius = np.concatenate([radius, particles.radius])
        batches.append(particles)
        assert smallest_gap(position, radius) >= -1e-12
    assert now < 0.25, "hardly any particle is queued"
    offset = np.concatenate([particles.position for particles in batches]) - center
    depth = offset @ np.array(normal)
    across = offset - depth[:, None] * np.array(normal)
    assert np.all(depth >= radius - 1e-12) and depth.max() <= 2 * radius.max() + 1.0 * 0.0004
    if "disc" in face:
        assert np.all(np.linalg.norm(across, axis=1) + radius <= 0.03 + 1e-12)
    else:
        assert np.all(np.abs(across[:, :2]) + radius[:, None] <= np.array([0.025, 0.03]) + 1e-12)
    np.testing.assert_array_equal(batches[0].velocity[0], normal)


def test_a_flow_is_limited_to_its_stages():
    """From the actual start of the stage `fill`, 0.3 s, to that of `rest`; the number is 40 /s times 0.5 s."""
    insertion = {"kind": "rain", "region": REGION, "rate": 40.0, "stages": ["fill"]}
    text = scene_with({"rain": {"diameter": 0.004, "insert": insertion | {"stages": None}}}).to_yaml()
    stages = "[{name: wait, duration: 1}, {name: fill, duration: 0.5}, {name: rest, duration: 2}]"
    scene = scene_of(
        text, "scene", ["particles.rain.insert.stages=[fill]", f"stages={stages}", "run={velocity_max: 5}"]
    )
    (rain,) = inserters(scene)
    assert len(rain.radius) == 20
    rain.begin_stage("wait", 0.0)
    assert np.isinf(rain.next_time) and not rain.is_pending
    rain.begin_stage("fill", 0.3)
    assert rain.next_time == 0.3 and rain.is_pending
    none = np.empty((0, 3)), np.empty(0)
    assert len(rain.insert_due(0.4, *none).radius) == 5
    (resumed,) = inserters(scene)
    resumed.load_state_dict(rain.state_dict())
    assert resumed.next_time == rain.next_time > 0.4
    assert len(resumed.insert_due(0.5, *none).radius) == 4
    resumed.begin_stage("rest", 0.5)
    assert np.isinf(resumed.next_time) and not resumed.is_pending
    (ended,) = inserters(scene)
    ended.load_state_dict(resumed.state_dict())
    assert np.isinf(ended.next_time) and ended.is_inserted.sum() == 9
