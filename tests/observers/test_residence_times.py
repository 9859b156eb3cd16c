"""Residence times: who enters, who leaves, and the moments of their times."""

import numpy as np
import pytest
from observers.snapshots import snapshot_of, spheres_of

from granflow.observers.meters import FlowCounter
from granflow.observers.passages import ResidenceTimes
from granflow.scene.blocks.output import FlowMeter, ResidenceTime

NAMES = {"group": ["feed", "tracer"], "material": ["glass"]}


def measured(given, paths, begins_at="top", stages=None):
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
    found = measured(given, PATHS)
    assert (found["residence_count"], found["residing_count"]) == (count, residing)
    assert found["residing_mass"] == 3.0 * residing  # particle 3, a tracer
    assert found["residence_mean"] == pytest.approx(mean, rel=1e-14)


def test_without_from_the_insertion_begins_the_time_and_each_particle_counts_once():
    """Exits through x = 3: 0 at 1.5, 1 at 0.75, 2 at 2.75, 4 at 0.5 s and again at 2.5 s."""
    found = measured({"to": "out"}, PATHS, begins_at=None)
    times = np.array([1.5, 0.75 - 0.1, 2.75 - 0.2, 0.5 - 0.4])
    weights = np.array([1.0, 3.0, 1.0, 1.0])
    mean = (weights * times).sum() / weights.sum()
    variance = (weights * (times - mean) ** 2).sum() / weights.sum()
    assert (found["residence_count"], found["residing_count"], found["residing_mass"]) == (4, 1, 3.0)
    assert found["residence_mean"] == pytest.approx(mean, rel=1e-14)
    assert found["residence_deviation"] == pytest.approx(variance**0.5, rel=1e-13)
    assert found["tanks_in_series"] == pytest.approx(mean**2 / variance, rel=1e-13)
    assert measured({"from": "feed", "to": "out"}, PATHS, begins_at=None)["residence_count"] == 3


def test_hold_up_over_the_flow_is_the_residence_time():
    """Particle k enters at k + 0.5 s and leaves 1.5 intervals later: before the first exit 0, 1, 2 reside, then
    always two; a flow of one particle per second, and a residence time of 2 s (Little's law)."""
    count = 12
    paths = {k: [0] * (k + 1) + [2, 2] + [4] * (count - k) for k in range(count)}
    residing = [0, 1, 2, *[2] * (count - 3)]
    found = measured({"from": "top", "to": "out"}, {k: path[:count] for k, path in paths.items()})
    assert found["residence_mean"] == pytest.approx(2.0)
    assert found["residing_count_mean"] == pytest.approx(np.mean(residing))


def test_mean_of_the_last_stage_leaves_out_the_start_up():
    """Particles 0 and 2 of 1 kg leave in the stage fill after 1 and 2 s, 1 of 3 kg and 4 of 1 kg in the last
    one after 3 and 1 s."""
    paths = {0: [0, 2, 4, 4, 4, 4], 2: [0, 2, 2, 4, 4, 4], 1: [0, 0, 2, 2, 2, 4], 4: [0, 0, 0, 2, 4, 4]}
    stages = ["fill", "fill", "fill", "fill", "run", "run"]
    found = measured({"from": "top", "to": "out"}, paths, stages=stages)
    assert found["residence_mean"] == pytest.approx((1.0 + 2.0 + 3.0 * 3.0 + 1.0) / 6.0)
    assert found["residence_stage_mean"] == pytest.approx((3.0 * 3.0 + 1.0) / 4.0)
