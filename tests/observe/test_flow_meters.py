"""A meter follows every particle through its plane, and back."""

import numpy as np
import pytest
from observe.snapshots import snapshot_of

from granflow.observe import FlowMeter
from granflow.observe.flow_meters import steady_flow


def seen(meter, *samples):
    """Show the meter {id: (position, mass)} at times 0, 1, 2, ...; return mass and count."""
    for time, particles in enumerate(samples):
        ids = sorted(particles)
        arrays = {
            "id": np.array(ids, dtype=np.int64),
            "position": np.array([particles[i] for i in ids], dtype=float).reshape(-1, 3),
            "mass": np.array([2.0**i for i in ids]),
        }
        meter.update(snapshot_of(time=float(time), particles=arrays))
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


def test_a_rectangle_counts_who_passes_within_its_sides():
    meter = FlowMeter((0, 0, 1), (0, 0, -1), sides=((2, 0, 0), (0, 1, 0)))
    above = {0: (1, 0.5, 2), 1: (1, 1.5, 2), 2: (2.5, 0.5, 2), 3: (-0.1, 0.5, 2), 4: (1.9, 0.1, 1.1)}
    below = {i: (x, y, 0.5) for i, (x, y, z) in above.items() if i != 4}
    assert seen(meter, above, below) == (2.0**0 + 2.0**4, 2)


def test_materials_are_counted_by_themselves_too():
    def update(meter, time, heights):
        ids = np.array(sorted(heights))
        arrays = {
            "id": ids, "position": np.array([[0.0, 0.0, heights[i]] for i in ids]), "mass": 2.0**ids,
            "material": ids % 2,
        }  # fmt: skip
        meter.update(snapshot_of(time=time, particles=arrays))

    def meter():
        return FlowMeter((0, 0, 1), (0, 0, -1), group_by="material", parts=("glass", "steel"))

    whole, first, again = meter(), meter(), meter()
    moments = ((0.0, {0: 2, 1: 2, 2: 2, 3: 2}), (1.0, {0: 0, 1: 2, 2: 0, 3: 0}), (2.0, {1: 0}))
    for moment in moments:
        update(whole, *moment)
    for moment in moments[:2]:
        update(first, *moment)
    again.load_state_dict(first.state_dict())
    update(again, *moments[2])
    assert whole.state_dict()["tallies"] == again.state_dict()["tallies"], (
        "a meter that goes on counts as one that never stopped"
    )
    assert (whole.mass, whole.count) == (1.0 + 2.0 + 4.0 + 8.0, 4)
    assert whole.parts["glass"].readings() == [5.0, 2, 0.0]
    assert whole.parts["steel"].readings() == [10.0, 2, 2.0]
    assert sum(tally.mass for tally in whole.parts.values()) == whole.mass
