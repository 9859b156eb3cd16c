"""The glossary is consistent with itself."""

import pytest

from granflow.quantities import (
    CONTACT_QUANTITIES,
    FLOW_METER_QUANTITIES,
    PARTICLE_QUANTITIES,
    RUN_QUANTITIES,
    TOTAL_QUANTITIES,
    unit_of,
)

ALL = [PARTICLE_QUANTITIES, CONTACT_QUANTITIES, FLOW_METER_QUANTITIES, RUN_QUANTITIES, TOTAL_QUANTITIES]


@pytest.mark.parametrize("quantity", [quantity for glossary in ALL for quantity in glossary.values()])
def test_every_word_is_explained_and_has_a_unit(quantity):
    assert quantity.name.isidentifier()
    assert quantity.name.islower()
    assert quantity.unit
    assert quantity.meaning


def test_the_same_word_has_the_same_unit_everywhere():
    units = {}
    for glossary in ALL:
        for name, quantity in glossary.items():
            assert units.setdefault(name, quantity.unit) == quantity.unit


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("kinetic_energy", "J"),
        ("mass_flow.outlet", "kg/s"),
        ("flow_count.outlet", ""),
        ("timings.neighbor_list", "s"),
        ("time_step", "s"),
        ("particle_count", ""),
        ("own_number", ""),
    ],
)
def test_unit_of_a_number_of_the_result(name, unit):
    assert unit_of(name) == unit


def test_labels_carry_units():
    assert TOTAL_QUANTITIES["kinetic_energy"].label == "kinetic_energy [J]"
    assert TOTAL_QUANTITIES["particle_count"].label == "particle_count"
    assert FLOW_METER_QUANTITIES["mass_flow"].label_of("outlet") == "mass_flow.outlet [kg/s]"
