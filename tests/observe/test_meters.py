"""A meter follows every particle through its plane, and back."""

import numpy as np
import pytest
from observe.snapshots import snapshot_of

from granflow.observe import FlowMeter
from granflow.observe.meters import steady_flow


def seen(meter, *looks):
    """Show the meter {id: (position, mass)} at times 0, 1, 2, ...; return mass and count."""
    for time, particles in enumerate(looks):
        ids = sorted(particles)
        arrays = {
            "id": np.array(ids, dtype=np.int64),
            "position": np.array([particles[i] for i in ids], dtype=float).reshape(-1, 3),
            "mass": np.array([2.0**i for i in ids]),
        }
        meter.look(snapshot_of(time=float(time), particles=arrays))
    return meter.mass, meter.count


def down(radius=None):
    return FlowMeter((0, 0, 1), (0, 0, -3), radius)


def test_crossing_and_back_and_again():
    meter = down()
    assert seen(meter, {0: (0, 0, 2), 1: (0, 0, 3)}, {0: (0, 0, 0.5), 1: (0, 0, 2)}) == (1.0, 1)
    assert seen(meter, {0: (0, 0, 1.5), 1: (0, 0, 0)}) == (2.0, 1)
    assert seen(meter, {0: (0, 0, 0.9), 1: (0, 0, 0)}) == (3.0, 2)


def test_a_particle_deleted_from_the_near_side_has_crossed():
    assert seen(down(), {0: (0, 0, 1.1), 1: (0, 0, 5)}, {1: (0, 0, 5)}) == (1.0, 1)


def test_a_particle_deleted_from_the_far_side_is_not_counted_twice():
    assert seen(down(), {0: (0, 0, 1.1)}, {0: (0, 0, 0.5)}, {}) == (1.0, 1)


def test_a_particle_deleted_beside_the_disc_has_not_crossed():
    assert seen(down(radius=1), {0: (5, 0, 1.1)}, {}) == (0.0, 0)


def test_far_side_at_first_look_and_newcomers_never_count():
    assert seen(down(), {0: (0, 0, 0)}, {0: (0, 0, -1), 3: (0, 0, 0.5)}, {0: (0, 0, -2), 3: (0, 0, 0)}) == (0.0, 0)


def test_only_a_crossing_within_the_radius_counts_wherever_it_ends():
    # Straight lines: 0 cuts the plane at x = 0.5, 1 at x = 1.5; both end at x = 1.
    assert seen(down(radius=1), {0: (0, 0, 2), 1: (2, 0, 2)}, {0: (1, 0, 0), 1: (1, 0, 0)}) == (1.0, 1)


def test_no_particles_at_all():
    assert seen(down(), {}, {}) == (0.0, 0)


def test_mass_flow_is_the_difference_between_looks():
    meter = down()
    seen(meter, {0: (0, 0, 2), 2: (0, 0, 2)}, {0: (0, 0, 0), 2: (0, 0, 0)})
    assert meter.mass_flow() == 5.0
    assert meter.result()["flow_mass"] == 5.0


def test_steady_flow_ignores_start_stragglers_and_other_stages():
    filling = [(float(t), "fill", 0.0) for t in range(3)]
    times = np.arange(2.1, 8.0, 0.1)
    mass = np.interp(times, [2, 3, 5, 7.9], [0.0, 1.0, 9.0, 10.0])
    flowing = [(float(t), "discharge", float(m)) for t, m in zip(times, mass, strict=True)]
    still = [(9.0, "rest", 10.0), (10.0, "rest", 10.0)]
    assert steady_flow(filling + flowing + still) == pytest.approx(4.0)


def test_steady_flow_of_a_backward_flow_is_negative():
    assert steady_flow([(0.0, "run", 0.0), (1.0, "run", -1.0), (2.0, "run", -2.0)]) == pytest.approx(-1.0)


@pytest.mark.parametrize("history", [[], [(0.0, "run", 0.0)], [(0.0, "run", 0.0), (1.0, "run", 0.0)]])
def test_steady_flow_is_zero_where_nothing_flows(history):
    assert steady_flow(history) == 0.0


def test_steady_flow_counts_what_passes_between_the_last_look_of_one_stage_and_the_first_of_the_next():
    assert steady_flow([(0.0, "fill", 0.0), (1.0, "open", 1.0)]) == pytest.approx(1.0)
