"""The tables of quantities are consistent."""

import pytest

from granflow.fields import (
    CONTACT_QUANTITIES,
    FLOW_METER_QUANTITIES,
    PARTICLE_QUANTITIES,
    RUN_QUANTITIES,
    TOTAL_QUANTITIES,
)
from granflow.scene.blocks.output import unit_of

ALL = [PARTICLE_QUANTITIES, CONTACT_QUANTITIES, FLOW_METER_QUANTITIES, RUN_QUANTITIES, TOTAL_QUANTITIES]


def test_each_quantity_has_a_meaning_and_a_unit():
    for quantity in (each for table in ALL for each in table.values()):
        assert quantity.name.isidentifier() and quantity.name.islower(), quantity
        assert quantity.unit and quantity.meaning, quantity


def test_each_name_has_the_same_unit_in_all_tables():
    units = {}
    for table in ALL:
        for name, quantity in table.items():
            assert units.setdefault(name, quantity.unit) == quantity.unit


@pytest.mark.parametrize(("name", "unit"), [
    ("kinetic_energy", "J"), ("mass_flow.outlet", "kg/s"), ("flow_count.outlet", ""),
    ("timings.neighbor_list", "s"), ("time_step", "s"), ("particle_count", ""), ("own_number", "")
])  # fmt: skip
def test_unit_of_a_result_number(name, unit):
    assert unit_of(name) == unit
