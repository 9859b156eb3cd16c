"""Motions from tables: interpolation with a continuous rate, without overshoot; bounds of rate and
acceleration."""

from math import pi

import numpy as np
import pytest
from geometry.motions import table as table_motion
from scipy.integrate import trapezoid

from granflow.geometry.motion import MotionTable
from granflow.scene.blocks.motions import poses_at

TIMES, VALUES = (0.0, 0.2, 0.5, 0.6, 1.0), (0.3, 0.4, 0.4, 1.0, 0.1)
RATES = (0.0, 2.0, 2.0, -1.0, 0.0)


def test_displacements_pass_through_the_rows_without_overshoot():
    """The first row is the rest position; the displacement is constant between equal rows."""
    table = MotionTable.of_values(TIMES, VALUES)
    np.testing.assert_allclose(table.at(np.array(TIMES))[0], np.array(VALUES) - VALUES[0], atol=1e-15)
    times = np.linspace(0.0, 1.0, 1001)
    values, _ = table.at(times)
    row = np.minimum(np.searchsorted(TIMES, times, side="right") - 1, 3)
    before, after = (np.array(VALUES)[row + k] - VALUES[0] for k in (0, 1))
    assert (values >= np.minimum(before, after) - 1e-12).all() and (
        values <= np.maximum(before, after) + 1e-12
    ).all()
    np.testing.assert_allclose(table.at(np.linspace(0.2, 0.5, 50))[0], 0.1, atol=1e-14)


def test_velocities_are_linear_between_rows():
    """The displacement is the area below the polygon of the velocities."""
    table = MotionTable.of_rates(TIMES, RATES)
    times = np.linspace(0.0, 0.999, 500)
    values, rates = table.at(times)
    np.testing.assert_allclose(rates, np.interp(times, TIMES, RATES), atol=1e-13)
    area = [trapezoid(np.interp(x := np.unique([*np.linspace(0.0, t, 2001), *(r for r in TIMES if r < t)]),
                                   TIMES, RATES), x) for t in times[::50]]  # fmt: skip
    np.testing.assert_allclose(values[::50], area, atol=1e-12)


@pytest.mark.parametrize("table", [MotionTable.of_values(TIMES, VALUES), MotionTable.of_rates(TIMES, RATES)])
def test_rates_are_continuous_derivatives_within_their_bounds(table):
    step = 1e-6
    times = np.linspace(0.001, 0.999, 4999)
    value, rate = table.at(times)
    slope = (table.at(times + step)[0] - table.at(times - step)[0]) / (2 * step)
    np.testing.assert_allclose(rate, slope, atol=1.1 * step * table.largest_change_of_rate)
    assert np.abs(np.diff(rate)).max() <= 1.001 * table.largest_change_of_rate * np.diff(times)[0]
    assert 0.999 * table.largest_rate < np.abs(rate).max() <= table.largest_rate * (1 + 1e-12)
    change = np.abs(np.diff(rate) / np.diff(times)).max()
    assert 0.98 * table.largest_change_of_rate < change <= table.largest_change_of_rate * (1 + 1e-9)
    assert table.shortest_step == pytest.approx(0.1)
    assert len(value) == len(times)


def test_a_densely_tabulated_sine_is_a_vibration():
    """The error of the displacement is of second order in the spacing of the rows at the extrema."""
    times = np.linspace(0.0, 1.0, 201)
    displacements = 0.01 * np.sin(2 * pi * times)
    motion = table_motion(times, displacements=displacements, direction=(0.0, 0.0, 1.0), start=0.5)
    at = 0.5 + np.linspace(0.0, 0.999, 777)
    found = poses_at([motion], at)
    np.testing.assert_allclose(
        found.offset[:, 2], 0.01 * np.sin(2 * pi * (at - 0.5)), atol=0.01 * (2 * pi / 200) ** 2
    )
    assert motion.top_speed(0.0) == pytest.approx(0.02 * pi, rel=1e-3)


def test_the_wall_is_at_rest_outside_the_table():
    motion = table_motion(
        (0.1, 0.2), displacements=(0.0, 3.0), direction=(1.0, 0.0, 0.0), start=1.0, end=1.15
    )
    found = poses_at([motion], np.array([0.0, 1.05, 1.12, 1.5, 9.0]))
    np.testing.assert_allclose(found.offset[:, 0], [0.0, 0.0, 0.6, 1.5, 1.5], atol=1e-12)
    np.testing.assert_allclose(found.velocity[:, 0], [0.0, 0.0, 30.0, 0.0, 0.0], atol=1e-12)


def test_angles_turn_the_wall_about_the_axis():
    motion = table_motion((0.0, 1.0, 2.0), angles=(0.0, pi / 2, pi), point=(1, 0, 0), axis=(0, 0, 1))
    found = poses_at([motion], np.array([1.0, 2.5]))
    np.testing.assert_allclose(found.rotation @ [1, 0, 0], [[0, 1, 0], [-1, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(found.angular_velocity, [[0, 0, pi / 2], [0, 0, 0]], atol=1e-15)
    assert motion.top_speed(2.0) == pytest.approx(pi)
