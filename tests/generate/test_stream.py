"""Rain and inlets: what is due comes when there is room, never into what is there, and the same every time."""

import time
from math import inf

import numpy as np
import pytest
from generate.scenes import UNIFORM, room_left, scene_with, smallest_gap

from granflow.errors import SceneError
from granflow.scene.generate import Stream, streams
from granflow.scene.settle import settled

REGION = {"cylinder": {"from": [0, 0, 0.4], "to": [0, 0, 0.46], "radius": 0.08}}


def rain_of(count=8000, rate=8000.0, start=0.0, diameter=UNIFORM, region=REGION, seed=1):
    place = {"kind": "rain", "region": region, "rate": rate, "start": start}
    group = {"count": count, "diameter": diameter, "velocity": [0, 0, -0.5], "place": place}
    return Stream(
        scene_with(
            {"still": {"diameter": 0.004, "place": {"kind": "list", "positions": [[0, 0, 0]]}}, "rain": group}, seed
        ),
        "rain",
    )


def fallen(born, height, now):
    """Heights of grains that fall freely, through each other, from where they were born to the ground at 0."""
    age = now - born
    return np.maximum(height - 0.5 * age - 0.5 * 9.81 * age**2, 0.0)


def pour_all(rain, most=2000):
    """Pour until all have come, while those present fall; (time, grains) of each pour, all checked."""
    born, origin, radius, pours = np.empty(0), np.empty((0, 3)), np.empty(0), []
    while rain.remaining and len(pours) < most:
        now = rain.next_time
        position = origin.copy()
        position[:, 2] = fallen(born, origin[:, 2], now)
        grains = rain.pour(now, position, radius)
        pours.append((now, grains))
        assert smallest_gap(grains.position, grains.radius) >= -1e-12
        apart = np.linalg.norm(grains.position[:, None] - position, axis=2)
        assert (apart - grains.radius[:, None] - radius).min(initial=inf) >= -1e-12
        born = np.concatenate([born, np.full(len(grains), now)])
        origin = np.concatenate([origin, grains.position])
        radius = np.concatenate([radius, grains.radius])
    return pours


def test_all_come_on_time_and_clear():
    rain = rain_of(count=2000, rate=4000.0, start=0.1)
    pours = pour_all(rain)
    assert rain.remaining == 0 and rain.next_time == inf
    count = sum(len(grains) for _, grains in pours)
    assert count == 2000
    arrived = 0
    for now, grains in pours:
        arrived += len(grains)
        due = (now - 0.1) * 4000 + 1
        assert due - 5 * rain.batch <= arrived <= due + 1e-6
    assert pours[0][0] == 0.1
    assert pours[-1][0] == pytest.approx(0.1 + 1999 / 4000, abs=5 * rain.batch / 4000)
    assert min(room_left(REGION, grains.position, grains.radius) for _, grains in pours if len(grains)) >= -1e-12
    came = np.sort(np.concatenate([grains.radius for _, grains in pours]))
    np.testing.assert_array_equal(came, np.sort(rain.radius))


def test_same_rain_every_time_and_another_for_another_seed():
    first, again, other = (pour_all(rain_of(count=300, seed=seed)) for seed in (1, 1, 2))
    for (now, grains), (then, twin) in zip(first, again, strict=True):
        assert now == then
        np.testing.assert_array_equal(grains.position, twin.position)
        np.testing.assert_array_equal(grains.radius, twin.radius)
    assert not np.any(first[0][1].position == other[0][1].position)


def test_what_finds_no_room_waits():
    """A sphere fills the region: nothing comes. It goes away: all that were due come, oldest first."""
    rain = rain_of(count=50, rate=1000.0, diameter=0.004)
    plug = np.array([[0, 0, 0.43]]), np.array([0.2])
    for now in (0.0, 0.005, 0.01):
        assert len(rain.pour(now, *plug)) == 0
    assert rain.remaining == 50 and list(rain.waiting) == list(range(11))
    assert rain.next_time > 0.01
    came = 0
    while rain.remaining:
        came += len(rain.pour(rain.next_time, np.empty((0, 3)), np.empty(0)))
    assert came == 50


def test_a_clogged_region_is_left_alone():
    """Grains that never leave: the region fills up to what finds room by chance, then nothing more comes."""
    rain = rain_of(count=4000, rate=1e5, diameter=0.008)
    position, radius = np.empty((0, 3)), np.empty(0)
    for _ in range(100):
        grains = rain.pour(rain.next_time, position, radius)
        position, radius = np.concatenate([position, grains.position]), np.concatenate([radius, grains.radius])
    assert smallest_gap(position, radius) >= -1e-12
    assert rain.remaining == 4000 - len(radius) > 0


def test_velocity_group_and_material():
    grains = rain_of(count=5).pour(0.0, np.empty((0, 3)), np.empty(0))
    assert len(grains) == 1
    np.testing.assert_array_equal(grains.velocity, [[0, 0, -0.5]])
    assert grains.group.tolist() == [1] and grains.material.tolist() == [1]


def test_slow_rain_comes_one_by_one():
    pours = pour_all(rain_of(count=10, rate=20.0))
    np.testing.assert_allclose([now for now, _ in pours], np.arange(10) / 20, atol=1e-12)
    assert [len(grains) for _, grains in pours] == [1] * 10


def test_too_wide_for_the_region():
    place = {"kind": "rain", "region": REGION, "rate": 1.0}
    with pytest.raises(SceneError, match=r"particles\.wide\.count is 3, but none fits in its region"):
        streams(scene_with({"wide": {"count": 3, "diameter": 0.07, "place": place}}))


def test_streams_of_a_scene():
    place = {"kind": "rain", "region": REGION, "rate": 1.0}
    groups = {name: {"count": 3, "diameter": 0.004, "place": place} for name in ("first", "second")}
    found = streams(scene_with(groups))
    assert [each.group_name for each in found] == ["first", "second"]
    places = [each.pour(0.0, np.empty((0, 3)), np.empty(0)).position for each in found]
    assert not np.any(places[0] == places[1])


def test_eight_thousand_pour_quickly():
    rain = rain_of()
    settled = np.random.default_rng(1).uniform(-0.08, 0.08, (8000, 3))
    spent, pours = 0.0, 0
    while rain.remaining:
        begin = time.perf_counter()
        rain.pour(rain.next_time, settled, np.full(8000, 0.002))
        spent += time.perf_counter() - begin
        pours += 1
    assert 100 <= pours <= 1100
    assert spent < 6.0  # 3 s asked; twice that before a busy machine fails the test


def stream_with(place, **group):
    """A settled stream of glass, 2500 kg/m3."""
    given = {"diameter": UNIFORM, "place": place} | group
    still = {"diameter": 0.004, "place": {"kind": "list", "positions": [[0, 0, 0]]}}
    return Stream(settled(scene_with({"still": still, "stream": given})), "stream")


def test_a_mass_flow_is_kept_within_a_grain():
    """0.4 kg/s for half a second: after every pour what has come is what should have, but for the last grain."""
    place = {"kind": "rain", "region": REGION, "mass_flow": 0.4, "start": 0.1, "end": 0.6}
    stream = stream_with(place)
    heaviest = 4 / 3 * np.pi * 0.0025**3 * 2500
    came = 0.0
    for now, grains in pour_all(stream):
        assert not len(stream.waiting)
        came += float((4 / 3 * np.pi * grains.radius**3 * 2500).sum())
        assert 0.0 <= came - 0.4 * (now - 0.1) <= heaviest * (1 + 1e-9)
    assert came == pytest.approx(0.4 * 0.5, abs=heaviest)
    assert stream.remaining == 0 and stream.due_at[-1] < 0.6


def test_size_classes_keep_their_shares_all_along():
    """By mass 1 : 1 : 2 in 2, 3 and 4 mm: by number 1/8 : 1/27 : 2/64.

    The j-th of n comes at the share (j + 1/2) / n of the stream, so that each of three classes is within half a grain
    of its part of that share, the share within 3/2 of its part of all, and the count of each within 1/2 + 3/2 n/N.
    """
    number = np.arange(1, 1001)
    parts = {0.002: 1 / 8, 0.003: 1 / 27, 0.004: 2 / 64}
    classes = [{"diameter": d, "fraction": f} for d, f in zip(parts, (1, 1, 2), strict=True)]
    sizes = {"distribution": "classes", "by": "mass", "classes": classes}
    stream = stream_with({"kind": "rain", "region": REGION, "rate": 1000.0}, diameter=sizes, count=1000)
    for diameter, part in parts.items():
        came = np.cumsum(np.isclose(2 * stream.radius, diameter))
        assert abs(came[-1] - 1000 * part / sum(parts.values())) < 1
        assert np.abs(came - came[-1] * number / 1000).max() <= 0.5 + 1.5 * came[-1] / 1000


@pytest.mark.parametrize(
    ("face", "normal", "centre"),
    [
        ({"disc": {"center": [0.1, 0, 0.2], "normal": [3, 0, -4], "radius": 0.03}}, [0.6, 0, -0.8], [0.1, 0, 0.2]),
        ({"rectangle": {"corner": [0, 0, 0.2], "sides": [[0, 0.06, 0], [0.05, 0, 0]]}}, [0, 0, -1], [0.025, 0.03, 0.2]),
    ],
)
def test_an_inlet_lets_whole_grains_in_behind_its_face(face, normal, centre):
    """No deeper than they come at 1 m/s between two pours: 1000 at 5000 /s in 500 pours, 0.4 ms each."""
    place = {"kind": "inlet", "face": face, "rate": 5000.0}
    stream = stream_with(place, count=1000, velocity=normal)
    position, radius, seen = np.empty((0, 3)), np.empty(0), []
    now = 0.0
    while stream.remaining:
        step = stream.next_time - now
        now, position = stream.next_time, position + step * np.array(normal)
        grains = stream.pour(now, position, radius)
        position, radius = np.concatenate([position, grains.position]), np.concatenate([radius, grains.radius])
        seen.append(grains)
        assert smallest_gap(position, radius) >= -1e-12
    assert now < 0.25, "next to nobody waited"
    entered = np.concatenate([grains.position for grains in seen]) - centre
    depth = entered @ np.array(normal)
    across = entered - depth[:, None] * np.array(normal)
    assert np.all(depth >= radius - 1e-12) and depth.max() <= 2 * radius.max() + 1.0 * 0.0004
    if "disc" in face:
        assert np.all(np.linalg.norm(across, axis=1) + radius <= 0.03 + 1e-12)
    else:
        assert np.all(np.abs(across[:, :2]) + radius[:, None] <= np.array([0.025, 0.03]) + 1e-12)
    np.testing.assert_array_equal(seen[0].velocity[0], normal)
