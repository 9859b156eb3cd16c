"""Definitions of all quantities in snapshots and output files: name, symbol, SI unit, meaning.

The name is the key in a `Snapshot`, the name of the array in a VTU file and, for totals, the name of the column in
`timeseries.csv` and of the quantity in the `expect:` block of a scene.

Each mapping contains the definitions of one kind of array or number by name; it is read-only.
"""

from granflow.fields.arrays import CONTACT_QUANTITIES, FIELD_QUANTITIES, WALL_ARRAY_QUANTITIES
from granflow.fields.metrics import METRIC_QUANTITIES
from granflow.fields.particles import PARTICLE_QUANTITIES, DeviceType, FieldSpec
from granflow.fields.quantity import FileType, Kind, Quantity, units
from granflow.fields.run_numbers import (
    ENERGY_BUDGET_QUANTITIES,
    FLOW_METER_QUANTITIES,
    INSERTION_QUANTITIES,
    OUTLET_QUANTITIES,
    RUN_QUANTITIES,
    TOTAL_QUANTITIES,
    WALL_FORCE_QUANTITIES,
    WALL_QUANTITIES,
    unit_of,
)

__all__ = [
    "CONTACT_QUANTITIES",
    "ENERGY_BUDGET_QUANTITIES",
    "FIELD_QUANTITIES",
    "FLOW_METER_QUANTITIES",
    "INSERTION_QUANTITIES",
    "METRIC_QUANTITIES",
    "OUTLET_QUANTITIES",
    "PARTICLE_QUANTITIES",
    "RUN_QUANTITIES",
    "TOTAL_QUANTITIES",
    "WALL_ARRAY_QUANTITIES",
    "WALL_FORCE_QUANTITIES",
    "WALL_QUANTITIES",
    "DeviceType",
    "FieldSpec",
    "FileType",
    "Kind",
    "Quantity",
    "unit_of",
    "units",
]
