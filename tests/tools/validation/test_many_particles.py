"""Validation cases of many particles: their evaluation against constructed records, and small runs."""

import numpy as np
import pytest
from validation import cooling, rheology, silo, vibrated

from granflow.snapshot import Snapshot


def statuses(cases):
    """Statuses of the cases, in their order."""
    return [each.status for each in cases]


def test_integrated_cooling_of_constant_restitution_is_haffs_law():
    """theta = theta_0 (1 + (1 - e^2) w t / 6)^-2."""
    dilute = cooling.Gas(600, 1e-3, 0.02**3)
    time, theta = cooling.cooling_curve(dilute, lambda speed: np.full_like(speed, 0.8), 0.5, 0.06)
    rate = 0.36 * dilute.collision_rate(0.5) / 6.0
    np.testing.assert_allclose(theta, 0.5 * (1.0 + rate * time) ** -2.0, rtol=1e-6)
    assert cooling.haff_slope(dilute, 0.8, 0.5) == pytest.approx(rate, rel=0.003)
    assert cooling.exponent(time, theta) == pytest.approx(0.5, abs=1e-6)


def test_evaluation_of_the_flights_of_a_vibrated_particle():
    flights = vibrated.flights_of_map(3.8)
    assert statuses(vibrated.flight_cases(3.8, flights, 400)) == ["pass", "pass"]
    single = np.full(len(flights), flights.mean())
    assert statuses(vibrated.flight_cases(3.8, single, 400)) == ["fail", "fail"]
    assert statuses(vibrated.flight_cases(3.8, flights[:0], 400)) == ["fail", "fail"]
    assert statuses(vibrated.flight_cases(0.9, flights[:0], 400)) == ["pass"]
    assert statuses(vibrated.flight_cases(0.9, flights, 400)) == ["fail"]


def column_record(share_of_janssen, levels=4000):
    """A snapshot of a column of particles whose wall carries the given share of what Janssen's law
    predicts."""
    height = 6.0 * silo.SILO_RADIUS
    friction = silo.FRICTION
    ratio = 0.7
    area = np.pi * silo.SILO_RADIUS**2
    z = (np.arange(levels) + 0.5) * height / levels
    mass = np.full(levels, 1500.0 * area * height / levels)
    length = silo.SILO_RADIUS / (2.0 * friction * ratio)
    vertical = 1500.0 * silo.GRAVITY * length * -np.expm1(-(height - z) / length)
    normal = (
        ratio * vertical * 2.0 * np.pi * silo.SILO_RADIUS * height / levels * share_of_janssen(z / height)
    )
    weight = silo.GRAVITY * mass.sum()
    force = np.zeros((levels + 1, 3))
    force[:, 2] = [weight - friction * normal.sum(), *(friction * normal)]
    contacts = {
        "wall": np.array([0, *[1] * levels]), "force": force, "normal_force": np.array([weight, *normal]),
        "position_j": np.stack([np.zeros(levels + 1), np.zeros(levels + 1), [0.0, *z]], axis=1),
    }  # fmt: skip
    position = np.stack([np.zeros(levels), np.zeros(levels), z], axis=1)
    return Snapshot(1.0, 1, "lift", {"position": position, "mass": mass}, contacts, {}, {})


def test_evaluation_of_a_silo_recovers_janssens_law():
    """It rejects a wall whose lower third carries nothing."""
    balance, share = silo.evaluate_silo([column_record(np.ones_like)] * 10)
    assert balance.value == pytest.approx(1.0, abs=1e-12)
    assert (share.value, share.status) == (pytest.approx(share.reference, abs=0.01), "pass")
    record = column_record(lambda height: np.where(height < 1.0 / 3.0, 0.0, 1.0))
    assert statuses(silo.evaluate_silo([record] * 10)) == ["pass", "fail"]


def test_evaluation_of_the_discharge_recovers_beverloos_law():
    """A wrong flow fails in a wide silo and misses in narrow ones."""
    cases = silo.discharge_cases(flows_of=lambda radius, _: [silo.beverloo_flow(2.0 * radius)] * 3)
    assert statuses(cases) == ["pass"] * 8
    assert [each.value for each in cases[-2:]] == pytest.approx([1.4, 2.5], rel=1e-6)
    cases = silo.discharge_cases(flows_of=lambda radius, _: [2.0 * silo.beverloo_flow(2.0 * radius)] * 3)
    assert statuses(cases) == ["miss"] * 5 + ["fail"] + ["pass"] * 2


def sheared_fields(inertial_number, friction, solid_fraction):
    """Fields of a layer of 60 mm with the same inertial number at all heights."""
    height = np.linspace(0.5e-3, 59.5e-3, 60)
    normal = 1400.0 * 9.0 * (60e-3 - height)
    rate = inertial_number * np.sqrt(normal / rheology.DENSITY) / rheology.DIAMETER
    velocity = np.zeros((60, 3))
    velocity[:, 0] = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(height))])
    stress = np.zeros((60, 3, 3))
    stress[:, 2, 2], stress[:, 0, 2] = -normal, friction * normal
    position = np.stack([0.0 * height, 0.0 * height, height], axis=1)
    return {
        "position": position, "velocity": velocity, "solid_fraction": np.full(60, solid_fraction),
        "contact_stress": 0.9 * stress.reshape(60, 9), "kinetic_stress": 0.1 * stress.reshape(60, 9),
    }  # fmt: skip


def test_evaluation_of_a_sheared_layer():
    found = rheology.layer_shear(sheared_fields(0.2, 0.45, 0.58))
    assert (found.inertial_number, found.friction) == (pytest.approx(0.2, rel=1e-3), pytest.approx(0.45))
    law = rheology.Shear(0.2, rheology.friction_at(0.2), 0.58)
    assert statuses(rheology.shear_cases("layer", law)) == ["pass", "pass"]
    assert statuses(rheology.shear_cases("layer", rheology.Shear(0.2, 0.6, 0.5))) == ["fail", "fail"]
    assert statuses(rheology.shear_cases("layer", rheology.Shear(0.5, 0.9, 0.4))) == ["miss", "miss"]
