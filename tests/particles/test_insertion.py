"""Rain and inlets: due particles are inserted without overlap as soon as space is free, and reproducibly."""

from math import inf

import numpy as np
import pytest
from particles.scenes import UNIFORM, clearance, scene_with, smallest_gap

from granflow.errors import SceneError
from granflow.load import scene_of
from granflow.particles.insertion import inserters

REGION = {"cylinder": {"from": [0, 0, 0.4], "to": [0, 0, 0.46], "radius": 0.08}}
NOTHING = np.empty((0, 3)), np.empty(0)


def inserter_of(seed=1, diameter=UNIFORM, group=None, **insertion):
    """The inserter of a group of glass, 2500 kg/m3, with an inlet if a face is given, else with rain; another
    group does not move."""
    kind = {"kind": "inlet"} if "face" in insertion else {"kind": "rain", "region": REGION}
    rain = {"diameter": diameter, "velocity": [0, 0, -0.5]} | (group or {})
    rain["insert"] = kind | insertion
    still = {"diameter": 0.004, "insert": {"kind": "positions", "positions": [[0, 0, 0]]}}
    (found,) = inserters(scene_with({"still": still, "rain": rain}, seed))
    return found


def insert_all(rain, speed=(0.0, 0.0, -0.5)):
    """Insert all particles while inserted ones move at a speed [m/s]: (time, particles) of each batch.

    Checks each batch for overlaps.
    """
    position, radius = NOTHING
    batches, now = [], rain.next_time
    while rain.remaining and len(batches) < 2000:
        position = position + (rain.next_time - now) * np.array(speed)
        now = rain.next_time
        particles = rain.insert_due(now, position, radius)
        batches.append((now, particles))
        position = np.concatenate([position, particles.position])
        radius = np.concatenate([radius, particles.radius])
        assert smallest_gap(position, radius) >= -1e-12
    return batches


def test_all_particles_are_inserted_on_time_without_overlap():
    rain = inserter_of(group={"count": 1000}, rate=4000.0, start=0.1)
    batches = insert_all(rain)
    assert rain.remaining == 0 and rain.next_time == inf
    inserted = np.cumsum([len(particles) for _, particles in batches])
    due = [(now - 0.1) * 4000 + 1 for now, _ in batches]
    assert inserted[-1] == 1000 and np.all(inserted <= np.array(due) + 1e-6)
    assert np.all(inserted >= np.array(due) - 5 * rain.batch)
    assert batches[0][0] == 0.1
    assert batches[-1][0] == pytest.approx(0.1 + 999 / 4000, abs=5 * rain.batch / 4000)
    full = [particles for _, particles in batches if len(particles)]
    assert min(clearance(REGION, each.position, each.radius) for each in full) >= -1e-12
    radii = np.sort(np.concatenate([each.radius for each in full]))
    np.testing.assert_array_equal(radii, np.sort(rain.radius))


def test_insertion_is_reproducible_and_depends_on_the_seed_and_the_group():
    insertion = {"kind": "rain", "region": REGION, "rate": 1e5}
    groups = {name: {"count": 1500, "diameter": UNIFORM, "insert": insertion} for name in ("first", "second")}
    found = []
    for seed in (1, 1, 2):
        both = inserters(scene_with(groups, seed))
        assert [each.group_name for each in both] == ["first", "second"]
        found.append([each.insert_due(0.01, *NOTHING) for each in both])
    (first, second), (again, _), (other, _) = found
    for name in ("position", "radius"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert not np.any(first.position[:50] == other.position[:50])
    assert not np.any(first.position[:50] == second.position[:50])
    assert set(second.group) == {1}
    assert len(first) > 900 and smallest_gap(first.position, first.radius) >= -1e-12


def test_due_particles_are_queued_while_the_region_is_full_also_after_the_last_one_is_due():
    for count in (50, 11):
        rain = inserter_of(diameter=0.004, group={"count": count}, rate=1000.0)
        plug = np.array([[0, 0, 0.43]]), np.array([0.2])
        for now in (0.0, 0.005, 0.01):
            assert len(rain.insert_due(now, *plug)) == 0
        assert rain.remaining == count and list(rain.queued) == list(range(11))
        assert 0.01 < rain.next_time < 1.0
        assert sum(len(particles) for _, particles in insert_all(rain)) == count


def test_queued_particles_are_given_up_at_the_end():
    """200 particles are due in 10 ms; they are queued, and nothing enters after the end."""
    rain = inserter_of(rate=20000.0, end=0.01)
    while rain.next_time < inf:
        assert rain.next_time <= 0.01 + 1e-9
        rain.insert_due(rain.next_time, np.array([[0, 0, 0.43]]), np.array([0.2]))
    assert rain.due_count == 200 and len(rain.queued) > 0
    assert rain.is_over and not rain.is_pending


def test_particles_larger_than_the_region_are_rejected():
    with pytest.raises(SceneError, match=r"particles\.rain\.count is 3, but none fits in its region"):
        inserter_of(diameter=0.07, group={"count": 3}, rate=1.0)


def test_mass_flow_is_exact_within_one_particle():
    """0.4 kg/s for 0.3 s: after every batch the inserted mass is exact within the mass of one particle."""
    rain = inserter_of(mass_flow=0.4, start=0.1, end=0.4)
    heaviest = 4 / 3 * np.pi * 0.0025**3 * 2500
    inserted = 0.0
    for now, particles in insert_all(rain):
        inserted += float((4 / 3 * np.pi * particles.radius**3 * 2500).sum())
        assert 0.0 <= inserted - 0.4 * (now - 0.1) <= heaviest * (1 + 1e-9)
    assert inserted == pytest.approx(0.4 * 0.3, abs=heaviest)
    assert rain.remaining == 0 and rain.due_at[-1] < 0.4


def test_size_classes_keep_their_fractions_during_insertion():
    """Masses 1 : 1 : 2 in diameters of 2, 3 and 4 mm, so the numbers are 1/8 : 1/27 : 2/64.

    Particle j of a class with the share s is at the place (j + 1/2) / s of the sequence. Each of the three
    classes deviates by at most 1/2 particle at a given place, the place deviates by at most 3/2 insertions,
    and the count of a class by at most 1/2 + 3/2 s.
    """
    parts = {0.002: 1 / 8, 0.003: 1 / 27, 0.004: 2 / 64}
    classes = [{"diameter": d, "fraction": f} for d, f in zip(parts, (1, 1, 2), strict=True)]
    sizes = {"distribution": "classes", "by": "mass", "classes": classes}
    rain = inserter_of(diameter=sizes, group={"count": 1000}, rate=1000.0)
    for diameter, part in parts.items():
        inserted = np.cumsum(np.isclose(2 * rain.radius, diameter))
        share = part / sum(parts.values())
        assert abs(inserted[-1] - 1000 * share) < 1
        assert np.abs(inserted - share * np.arange(1, 1001)).max() <= 0.5 + 1.5 * share


@pytest.mark.parametrize("flow", [{"rate": 40.0, "start": 0.5}, {"mass_flow": 2e-3}])
def test_flow_without_count_lasts_as_long_as_the_run(flow):
    """The run of `scene_with` lasts 1 s. If it is extended to 3 s, the first particles are the same."""
    classes = [{"diameter": d, "fraction": d} for d in (0.003, 0.004)]
    sizes = {"distribution": "classes", "by": "number", "classes": classes}
    scene = scene_with({"rain": {"diameter": sizes, "insert": {"kind": "rain", "region": REGION} | flow}})
    (short,) = inserters(scene)
    insert_all(short)
    expected = 20 if "rate" in flow else pytest.approx(2e-3 / short.mass.mean(), abs=1.0)
    assert short.is_inserted.sum() == expected and short.remaining == 0
    (longer,) = inserters(scene_of(scene.to_yaml(), "resumed", ["run.duration=3 s"]))
    for name in ("radius", "due_at"):
        np.testing.assert_array_equal(getattr(longer, name)[: len(short.radius)], getattr(short, name))
    longer.load_state_dict(short.state_dict())
    assert short.due_at[-1] < longer.next_time < short.due_at[-1] + 2 * longer.batch * longer.interval
    insert_all(longer)
    assert longer.remaining == 0 and 2.9 < longer.due_at[-1] < 3.0


TILTED = {"disc": {"center": [0.1, 0, 0.2], "normal": [3, 0, -4], "radius": 0.03}}
FLAT = {"rectangle": {"corner": [0, 0, 0.2], "sides": [[0, 0.06, 0], [0.05, 0, 0]]}}


@pytest.mark.parametrize(
    ("face", "normal", "center"),
    [(TILTED, [0.6, 0, -0.8], [0.1, 0, 0.2]), (FLAT, [0, 0, -1], [0.025, 0.03, 0.2])],
)
def test_inlet_inserts_whole_particles_behind_its_face(face, normal, center):
    """The depth is at most the distance at 1 m/s between two batches: 500 at 5000 /s in 250 batches of 0.4 ms."""
    group = {"count": 500, "velocity": normal}
    batches = insert_all(inserter_of(group=group, face=face, rate=5000.0), normal)
    assert batches[-1][0] < 0.125, "hardly any particle is queued"
    radius = np.concatenate([particles.radius for _, particles in batches])
    offset = np.concatenate([particles.position for _, particles in batches]) - center
    depth = offset @ np.array(normal)
    across = offset - depth[:, None] * np.array(normal)
    assert np.all(depth >= radius - 1e-12) and depth.max() <= 2 * radius.max() + 1.0 * 0.0004
    if "disc" in face:
        assert np.all(np.linalg.norm(across, axis=1) + radius <= 0.03 + 1e-12)
    else:
        assert np.all(np.abs(across[:, :2]) + radius[:, None] <= np.array([0.025, 0.03]) + 1e-12)
    np.testing.assert_array_equal(batches[0][1].velocity[0], normal)


def test_a_flow_is_limited_to_its_stages():
    """From the actual start of the stage `fill`, 0.3 s, to that of `rest`; the number is 40 /s times 0.5 s."""
    insertion = {"kind": "rain", "region": REGION, "rate": 40.0}
    text = scene_with({"rain": {"diameter": 0.004, "insert": insertion}}).to_yaml()
    stages = "[{name: wait, duration: 1}, {name: fill, duration: 0.5}, {name: rest, duration: 2}]"
    changes = ["particles.rain.insert.stages=[fill]", f"stages={stages}", "run={velocity_max: 5}"]
    scene = scene_of(text, "scene", changes)
    (rain,), (resumed,) = inserters(scene), inserters(scene)
    assert len(rain.radius) == 20
    rain.begin_stage("wait", 0.0)
    assert rain.next_time == inf and not rain.is_pending
    rain.begin_stage("fill", 0.3)
    assert rain.next_time == 0.3 and rain.is_pending
    assert len(rain.insert_due(0.4, *NOTHING).radius) == 5
    resumed.load_state_dict(rain.state_dict())
    assert resumed.next_time == rain.next_time > 0.4
    assert len(resumed.insert_due(0.5, *NOTHING).radius) == 4
    resumed.begin_stage("rest", 0.5)
    assert resumed.next_time == inf and not resumed.is_pending and resumed.is_inserted.sum() == 9
