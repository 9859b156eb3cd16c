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


@pytest.mark.parametrize("quantity", [quantity for table in ALL for quantity in table.values()])
def test_each_quantity_has_a_meaning_and_a_unit(quantity):
    assert quantity.name.isidentifier()
    assert quantity.name.islower()
    assert quantity.unit
    assert quantity.meaning


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


def test_labels_contain_units():
    assert TOTAL_QUANTITIES["kinetic_energy"].label == "kinetic_energy [J]"
    assert TOTAL_QUANTITIES["particle_count"].label == "particle_count"
    assert FLOW_METER_QUANTITIES["mass_flow"].label_of("outlet") == "mass_flow.outlet [kg/s]"
