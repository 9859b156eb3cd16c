"""Flow meters count each particle that crosses their plane; residence times are those between two of them."""

from dataclasses import replace

import numpy as np
import pytest
from observers.snapshots import snapshot_of, spheres_of
from scene_builders import few_spheres

import granflow as gf
from granflow.geometry.periodic_box import PeriodicBox
from granflow.observers.meters import (
    FlowCount,
    FlowCounter,
    Passages,
    steady_flow,
    steady_flow_error,
)
from granflow.observers.passages import ResidenceTimes
from granflow.scene.blocks.output import FlowMeter, ResidenceTime


def falling(samples, **replaced):
    """Snapshots at times 0, 1, 2, ... of particles {id: position} with the mass 2^id [kg], inserted at -id / 2 [s]."""
    for time, places in enumerate(samples):
        ids = np.array(sorted(places), dtype=np.int64)
        position = np.array([places[i] for i in ids], dtype=float).reshape(-1, 3)
        arrays = {"velocity": 0.0 * position, "radius": 0.0 * ids + 0.2, "material": ids % 2}
        arrays |= {"id": ids, "mass": 2.0**ids, "insertion_time": -0.5 * ids}
        yield snapshot_of(time=float(time), particles=spheres_of(position, **arrays | replaced))


def measured(meter, *samples):
    """Mass and count of the meter after samples."""
    for snapshot in falling(samples):
        meter.update(snapshot)
    return meter.total.mass, meter.total.count


def down(radius=None):
    return FlowCounter(FlowMeter(point=(0, 0, 1), normal=(0, 0, -3), radius=radius), gravity=9.81)


UP, DOWN, FAR = (0, 0, 2), (0, 0, 0), (0, 0, 5)


@pytest.mark.parametrize(("radius", "samples", "expected"), [
    (None, [{0: UP, 1: (0, 0, 3)}, {0: (0, 0, 0.5), 1: UP}], (1.0, 1)),
    (None, [{0: DOWN, 1: UP}, {0: UP, 1: UP}, {0: UP, 1: DOWN}], (1.0, 0)),  # backward, then forward
    (None, [{0: (0, 0, 1.1), 1: FAR}, {1: FAR}], (1.0, 1)),  # deleted upstream
    (None, [{0: (0, 0, 6.0), 1: (0, 0, 6.2)}, {}], (1.0, 1)),  # the fall of 1 s and a radius are 4.9 + 0.2 m
    (None, [{0: (0, 0, 1.1)}, {0: (0, 0, 0.5)}, {}], (1.0, 1)),  # deleted after its crossing
    (1, [{0: (5, 0, 1.1)}, {}], (0.0, 0)),  # deleted outside of the disc
    (None, [{0: DOWN}, {0: DOWN, 3: (0, 0, 0.5)}, {0: DOWN, 3: DOWN}], (0.0, 0)),  # first sampled beyond
    (1, [{0: UP, 1: (2, 0, 2)}, {0: (1, 0, 0), 1: (1, 0, 0)}], (1.0, 1)),  # at x = 0.5, and at 1.5
    (None, [{}, {}], (0.0, 0)),
])  # fmt: skip
def test_crossings_are_counted_by_their_direction_within_the_radius(radius, samples, expected):
    assert measured(down(radius), *samples) == expected


def test_a_removed_particle_has_passed_if_it_was_beyond_the_plane():
    """All three vanish, after they were just before the plane. The outlets have deleted the first one; a stage or a
    program has removed the others before and behind the plane."""
    meter = down()
    removed = {"id": np.array([2, 1]), "position": np.array([[2.0, 0.0, 0.9], [1.0, 0.0, 1.05]])}
    for snapshot in falling([{0: (0, 0, 1.1), 1: (1, 0, 1.1), 2: (2, 0, 1.1)}, {}, {}]):
        meter.update(replace(snapshot, removed=removed if snapshot.time else {}))
    assert (meter.total.mass, meter.total.count) == (2.0**0 + 2.0**2, 2)


def test_steady_flow_ignores_start_end_and_other_stages():
    filling = [(float(t), "fill", 0.0) for t in range(3)]
    times = np.arange(2.1, 8.0, 0.1)
    mass = np.interp(times, [2, 3, 5, 7.9], [0.0, 1.0, 9.0, 10.0])
    flowing = [(float(t), "discharge", float(m)) for t, m in zip(times, mass, strict=True)]
    resting = [(9.0, "rest", 10.0), (10.0, "rest", 10.0)]
    assert steady_flow(filling + flowing + resting) == pytest.approx(4.0)
    assert steady_flow([]) == steady_flow([(0.0, "run", 0.0), (1.0, "run", 0.0)]) == 0.0
    assert steady_flow([(float(t), "run", -float(t)) for t in range(3)]) == pytest.approx(-1.0)
    assert steady_flow([(0.0, "fill", 0.0), (1.0, "open", 1.0)]) == pytest.approx(1.0), "between stages"


def test_rectangle_counts_particles_within_its_sides():
    meter = FlowCounter(FlowMeter(point=(0, 0, 1), normal=(0, 0, -1), sides=((2, 0, 0), (0, 1, 0))))
    above = {0: (1, 0.5, 2), 1: (1, 1.5, 2), 2: (2.5, 0.5, 2), 3: (-0.1, 0.5, 2), 4: (1.9, 0.1, 1.1)}
    below = {i: (x, y, 0.5) for i, (x, y, z) in above.items() if i != 4}
    assert measured(meter, above, below) == (2.0**0 + 2.0**4, 2)


def test_in_a_periodic_box_each_lap_counts_where_it_passes():
    """Uniform motions, up to two widths between two samples, through a quarter of the section and the whole plane.

    A particle passes z = 1 + 5 k at the times t, at the wrapped place of x + u t. Of an area that extends beyond the
    faces the images in the box count, too: an oblique disc and a plane at the upper faces count what they count in the
    middle, if all particles are displaced with them.
    """
    width = np.array([2.0, 3.0, 5.0])
    box = PeriodicBox((0, 1, 2), np.zeros(3), width)
    rng = np.random.default_rng(4)
    start, velocity = rng.uniform(0.0, width, (300, 3)), rng.uniform(-2.0, 2.0, (300, 3)) * width
    sides = ((1, 0, 0), (0, 1.5, 0))
    oblique = {"normal": (1, -2, 3), "radius": 0.8}
    areas = [{"sides": sides}, {}, {"point": (1.5, 2.25, 6), "sides": sides}]
    areas += [{"point": 0.5 * width, **oblique}, {"point": 0.5 * width, "normal": (1, 0, 0)}]
    at_corner = [each | {"point": width} for each in areas[3:]]
    meters = [
        FlowCounter(FlowMeter(**{"point": (0, 0, 1), "normal": (0, 0, 1)} | area), box)
        for area in areas + at_corner
    ]
    passed = []
    for time in range(4):
        for displaced, of_place in ((0.0, meters[:5]), (0.5, meters[5:])):
            places = box.wrap(start + displaced * width + time * velocity)
            (sample,) = falling([dict(enumerate(places))], velocity=velocity, mass=np.ones(300))
            for meter in of_place:
                meter.update(replace(sample, time=float(time)))
        passed += [] if time == 0 else [meters[0].passages.time]
    low, high = np.sort([start[:, 2], start[:, 2] + 3.0 * velocity[:, 2]], axis=0)
    times, within, beyond, count = [], 0, 0, 0
    for particle in range(300):
        for plane_height in 1.0 + 5.0 * np.arange(-8, 9):
            if low[particle] < plane_height < high[particle]:
                time = (plane_height - start[particle, 2]) / velocity[particle, 2]
                x, y = (start[particle] + time * velocity[particle])[:2] % width[:2]
                count += int(np.sign(velocity[particle, 2]))
                if x < 1.0 and y < 1.5:
                    times.append(time)
                    within += int(np.sign(velocity[particle, 2]))
                if (x < 0.5 or x > 1.5) and (y < 0.75 or y > 2.25):
                    beyond += int(np.sign(velocity[particle, 2]))
    assert len(times) > 150
    assert [meter.total.count for meter in meters[:3]] == [within, count, beyond]
    crossings = [meter.total.crossings[0] for meter in meters]
    assert crossings[3:5] == crossings[5:] and min(crossings) > 30
    np.testing.assert_allclose(np.concatenate(passed), np.sort(times), rtol=1e-9)


def test_group_by_material_counts_each_material_also_after_a_resume():
    plane = FlowMeter(point=(0, 0, 1), normal=(0, 0, -1), group_by="material")
    first, resumed = (FlowCounter(plane, parts=("glass", "steel")) for _ in range(2))
    snapshots = list(falling([{0: UP, 1: UP, 2: UP, 3: UP}, {0: DOWN, 1: UP, 2: DOWN, 3: DOWN}, {1: DOWN}]))
    first.update(snapshots[0])
    first.update(snapshots[1])
    resumed.load_state_dict(first.state_dict())
    for meter in (first, resumed):
        meter.update(snapshots[2])
    np.testing.assert_equal(resumed.state_dict()["tallies"], first.state_dict()["tallies"])
    assert (resumed.total.mass, resumed.total.count) == (1.0 + 2.0 + 4.0 + 8.0, 4)
    np.testing.assert_equal(list(resumed.parts["glass"].readings().values()), [5.0, 2, 0.0, np.nan])
    np.testing.assert_equal(list(resumed.parts["steel"].readings().values()), [10.0, 2, 2.0, 2.0])


def test_residence_time_ends_where_the_straight_path_reaches_the_plane():
    """Particles 0, 2 and 3 pass between 0 and 1 s, at 1/2, 1/2 and 1/4 s of a uniform motion; 1 passes
    backward. Particle 4, 1 m above the plane at 1 s with 4 m/s downward, is deleted: it passes at 1.25 s."""
    meter = down()
    assert np.isnan(meter.total.readings()["residence_time"]), "without passages"
    before = {0: UP, 1: DOWN, 2: UP, 3: (0, 0, 1.5), 4: UP}
    measured(meter, before, {0: DOWN, 1: UP, 2: DOWN, 3: (0, 0, -0.5), 4: UP})
    times = np.array([0.5, 0.5 + 1.0, 0.25 + 1.5])
    assert meter.total.readings()["residence_time"] == pytest.approx(times.mean(), rel=1e-15)
    saved = meter.state_dict()
    meter = down()
    saved["last"]["particles"]["velocity"] = np.array([[0, 0, -4.0]] * 5)
    meter.load_state_dict(saved)
    kept = {name: values[:4] for name, values in saved["last"]["particles"].items()}
    meter.update(snapshot_of(2.0, particles=kept))
    times = np.append(times, 1.25 + 0.5 * 4)
    assert meter.total.readings()["residence_time"] == pytest.approx(1.25 + 0.5 * 4, rel=1e-15)
    result = meter.total.result()
    assert result["residence_time"] == pytest.approx(times.mean(), rel=1e-15)
    assert result["residence_time_deviation"] == pytest.approx(times.std(), rel=1e-12)


def flowing(increments, dt=0.01):
    """History of a stage with the given masses [kg] between rows."""
    mass = np.concatenate([[0.0], np.cumsum(increments)])
    return [(dt * k, "run", float(m)) for k, m in enumerate(mass)]


def test_steady_flow_error_is_the_scatter_of_runs_with_independent_increments():
    """Mass increments N(mu, s) in each row: the mean of the n rows in the window scatters by s / sqrt(n). The
    correction for correlation can only enlarge the estimate, by less than 1.5 times for independent parts."""
    rng = np.random.default_rng(7)
    mu, s, dt, rows = 1e-3, 3e-4, 0.01, 400
    errors = [steady_flow_error(flowing(rng.normal(mu, s, rows), dt)) for _ in range(400)]
    expected = s / dt / np.sqrt(rows / 2)
    assert expected <= np.sqrt(np.mean(np.square(errors))) <= 1.5 * expected


def test_steady_flow_error_of_a_constant_flow_is_zero():
    """It is NaN for fewer than two rows per part."""
    assert np.isnan(steady_flow_error(flowing(np.full(36, 1e-3))))
    assert np.isnan(steady_flow_error(flowing(np.zeros(100))))
    assert steady_flow_error(flowing(np.full(200, 1e-3))) == pytest.approx(0.0, abs=1e-12)


def counted(count, duration, interval=0.1, mass=1.0, stages=((0.0, "run"),), seed=1):
    """A count of independent passages of equal particles, inserted at 0 s, at random times before `duration`
    [s]; and these times."""
    times = np.sort(np.random.default_rng(seed).uniform(0.0, duration, count))
    found = FlowCount()
    for k in range(round(duration / interval) + 1):
        now = k * interval
        stage = [name for begin, name in stages if begin <= now][-1]
        own = times[(times > now - interval) & (times <= now)]
        number = np.zeros(len(own), int)
        found.begin_sample(stage, False)
        found.add(
            Passages(
                time=own, direction=number + 1, id=number, mass=np.full(len(own), mass), radius=number + 0.1,
                group=number, material=number, insertion_time=0.0 * own,
            )
        )  # fmt: skip
        found.end_sample(now, stage)
    return found, times


def test_mean_flow_and_residence_time_of_the_last_stage():
    found, times = counted(60, 12.0, mass=0.5, stages=((0.0, "fill"), (4.05, "run")))
    late = times[times > 4.0]  # the stage begins at the last row before it
    result = found.result()
    assert result["mass_flow_mean"] == pytest.approx(0.5 * len(late) / 8.0)
    assert result["residence_time_mean"] == pytest.approx(late.mean())
    assert result["residence_time"] == pytest.approx(times.mean())
    restored = FlowCount()
    restored.load_state_dict(found.state_dict())
    assert restored.result() == result and not list(found.remarks())


@pytest.mark.parametrize(("count", "error"), [(4, "71 %"), (19, "32 %"), (20, ""), (0, "")])
def test_a_steady_flow_of_few_passages_has_their_counting_error(count, error):
    """sqrt(2 / n) for equal particles, since the middle half of the mass has n / 2 passages."""
    found, _ = counted(count, 10.0)
    result = found.result()
    sentences = list(found.remarks())
    assert (error in sentences[0]) if error else not sentences
    if error:
        assert result["mass_flow_error"] == pytest.approx(result["mass_flow"] * np.sqrt(2.0 / count))
        assert result["mass_flow_error_mean"] == pytest.approx(np.sqrt(count) / 10.0)


def test_a_clump_passes_once_with_its_center_of_mass():
    """A rod of two spheres of 1 kg, whose center is in the middle, and a single sphere; all fall by 2 m."""
    meter = down()
    for fallen in (0.0, 2.0):
        height = np.array([1.3, 1.9, 2.2]) - fallen
        place = np.outer(height, [0.0, 0.0, 1.0])
        center = np.outer([1.6 - fallen, 1.6 - fallen, 2.2 - fallen], [0.0, 0.0, 1.0])
        masses = {"mass": np.array([1.0, 1.0, 5.0]), "clump_mass": np.array([2.0, 2.0, 5.0])}
        own = {"clump": np.array([0, 0, -1]), "clump_position": center, "radius": np.array([0.1, 0.2, 0.3])}
        meter.update(snapshot_of(fallen, particles=spheres_of(place, **masses, **own)))
    assert (meter.total.count, meter.total.mass) == (2, 7.0)
    assert meter.passages.id.tolist() == [0, 2] and meter.passages.radius.tolist() == [0.2, 0.3]
    assert meter.passages.time == pytest.approx([0.6, 1.2])


NAMES = {"group": ["feed", "tracer"], "material": ["glass"]}


def resided(given, paths, begins_at="top", stages=None):
    """Residence times of particles on `paths` {id: [x at each time]}; odd ids are tracers of 3 kg, others 1 kg.

    top and out are at x = 1 and x = 3; a particle of x None does not exist. All are inserted at id / 10 s.
    """
    meters = {
        name: FlowCounter(FlowMeter(point=(x, 0, 0), normal=(1, 0, 0)))
        for name, x in (("top", 1), ("out", 3))
    }
    residence = ResidenceTimes(ResidenceTime(**given), NAMES, begins_at, None)
    for k in range(len(next(iter(paths.values())))):
        ids = np.array([number for number, path in paths.items() if path[k] is not None])
        position = np.outer([paths[i][k] for i in ids.tolist()], [1.0, 0.0, 0.0])
        particles = spheres_of(
            position, id=ids, velocity=0.0 * position, radius=0.1 + 0.0 * ids, mass=1.0 + 2.0 * (ids % 2),
            group=ids % 2, insertion_time=ids / 10.0,
        )  # fmt: skip
        snapshot = snapshot_of(float(k), particles=particles, stage=stages[k] if stages else "run")
        for meter in meters.values():
            meter.update(snapshot)
        residence.record(snapshot, meters)
    return residence.result()


PATHS = {
    0: [0, 2, 4, 4],  # enters at 0.5 s, leaves at 1.5 s
    1: [0, 4, 4, 4],  # both in one interval: at 1/4 and 3/4 s
    2: [0, 2, 0, 4],  # turns back, and enters again at 2.25 s; leaves at 2.75 s
    3: [0, 0, 2, 2],  # has not left
    4: [2, 4, 2, 4],  # has not entered
    5: [0, 2, None, None],  # deleted inside
}


@pytest.mark.parametrize(("given", "count", "mean", "residing"), [
    ({"from": "top", "to": "out"}, 3, (1 * 1.0 + 3 * 0.5 + 1 * 0.5) / 5, 1),
    ({"from": "top", "to": "out", "groups": ["tracer"]}, 1, 0.5, 1),
    ({"from": "top", "to": "out", "entered_between": [0.4, 0.6]}, 1, 1.0, 0),
    ({"from": "top", "to": "out", "entered_between": [2.1, 9.0]}, 1, 0.5, 0),
])  # fmt: skip
def test_a_residence_is_from_the_first_entrance_to_the_first_exit(given, count, mean, residing):
    found = resided(given, PATHS)
    assert (found["residence_count"], found["residing_count"]) == (count, residing)
    assert found["residing_mass"] == 3.0 * residing  # particle 3, a tracer
    assert found["residence_mean"] == pytest.approx(mean, rel=1e-14)


def test_without_from_the_insertion_begins_the_time_and_each_particle_counts_once():
    """Exits through x = 3: 0 at 1.5, 1 at 0.75, 2 at 2.75, 4 at 0.5 s and again at 2.5 s."""
    found = resided({"to": "out"}, PATHS, begins_at=None)
    times = np.array([1.5, 0.75 - 0.1, 2.75 - 0.2, 0.5 - 0.4])
    weights = np.array([1.0, 3.0, 1.0, 1.0])
    mean = (weights * times).sum() / weights.sum()
    variance = (weights * (times - mean) ** 2).sum() / weights.sum()
    assert (found["residence_count"], found["residing_count"], found["residing_mass"]) == (4, 1, 3.0)
    assert found["residence_mean"] == pytest.approx(mean, rel=1e-14)
    assert found["residence_deviation"] == pytest.approx(variance**0.5, rel=1e-13)
    assert found["tanks_in_series"] == pytest.approx(mean**2 / variance, rel=1e-13)
    assert resided({"from": "feed", "to": "out"}, PATHS, begins_at=None)["residence_count"] == 3


def test_hold_up_over_the_flow_is_the_residence_time():
    """Particle k enters at k + 0.5 s and leaves 1.5 intervals later: before the first exit 0, 1, 2 reside, then
    always two; a flow of one particle per second, and a residence time of 2 s (Little's law)."""
    count = 12
    paths = {k: [0] * (k + 1) + [2, 2] + [4] * (count - k) for k in range(count)}
    residing = [0, 1, 2, *[2] * (count - 3)]
    found = resided({"from": "top", "to": "out"}, {k: path[:count] for k, path in paths.items()})
    assert found["residence_mean"] == pytest.approx(2.0)
    assert found["residing_count_mean"] == pytest.approx(np.mean(residing))


def test_mean_of_the_last_stage_leaves_out_the_start_up():
    """Particles 0 and 2 of 1 kg leave in the stage fill after 1 and 2 s, 1 of 3 kg and 4 of 1 kg in the last
    one after 3 and 1 s."""
    paths = {0: [0, 2, 4, 4, 4, 4], 2: [0, 2, 2, 4, 4, 4], 1: [0, 0, 2, 2, 2, 4], 4: [0, 0, 0, 2, 4, 4]}
    stages = ["fill", "fill", "fill", "fill", "run", "run"]
    found = resided({"from": "top", "to": "out"}, paths, stages=stages)
    assert found["residence_mean"] == pytest.approx((1.0 + 2.0 + 3.0 * 3.0 + 1.0) / 6.0)
    assert found["residence_stage_mean"] == pytest.approx((3.0 * 3.0 + 1.0) / 4.0)


def test_residence_times_of_a_uniform_motion(taichi_f64, tmp_path):
    """Without gravity, particles of 4 mm start within two diameters behind the face with 0.5 m/s; the meter
    "out" is 0.2 m from it, and "gate" 0.05 m. From gate to out each needs 0.15 m / (0.5 m/s) = 0.3 s."""
    speed, distance, diameter = 0.5, 0.2, 0.004
    face = {"disc": {"center": [0, 0, 0], "normal": [0, 0, -1], "radius": 0.03}}
    feed = {
        "material": "glass", "diameter": diameter, "count": 40, "velocity": [0, 0, -speed],
        "insert": {"kind": "inlet", "face": face, "rate": 100.0},
    }  # fmt: skip
    meters = {"gate": {"point": [0, 0, -0.05], "normal": [0, 0, -1]},
              "out": {"point": [0, 0, -distance], "normal": [0, 0, -1], "passages": True}}  # fmt: skip
    scene = few_spheres(
        {"feed": feed}, run={"duration": 0.9, "velocity_max": 1.0},
        output={"interval": 0.01, "energy_budget": True, "flow_meters": meters,
                "residence_time": {"from": "gate", "to": "out"}},
    )  # fmt: skip
    with gf.Simulation(scene, out=tmp_path) as simulation:
        result = simulation.run()
    found = result.flow_meters["out"]
    assert found["flow_count"] == 40
    latest = distance / speed
    assert latest - 2 * diameter / speed < found["residence_time"] < latest
    assert 0 < found["residence_time_deviation"] < diameter / speed
    times = result.residence_time["out"]
    assert (times["residence_count"], times["residing_count"]) == (40, 0)
    assert times["residence_mean"] == pytest.approx(0.3, rel=1e-9)
    assert times["residence_deviation"] < 1e-9 and np.isnan(times["tanks_in_series"])
    rows = np.genfromtxt(
        tmp_path / "residence_time.csv", delimiter=",", skip_header=1, usecols=(0, 1, 2, 6, 7)
    )
    np.testing.assert_allclose(rows[:, 2], 0.3, rtol=1e-9)
    np.testing.assert_allclose(rows[:, 0] - rows[:, 1], rows[:, 2], rtol=1e-9)
    np.testing.assert_allclose(rows[:, 4], 2500.0 * np.pi / 6.0 * rows[:, 3] ** 3, rtol=1e-6)
    passages = np.genfromtxt(tmp_path / "passages_out.csv", delimiter=",", skip_header=1, usecols=(0, 1, 2))
    np.testing.assert_array_equal(passages[:, 0], rows[:, 0])
    assert passages[:, 2].mean() == pytest.approx(found["residence_time"], rel=1e-9)
