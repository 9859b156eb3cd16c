"""Reference pages of the files of a run: time series, VTU arrays, metrics, result.json; and of units and
presets."""

from collections.abc import Iterable, Mapping

from docsite.markdown import code, table
from granflow import fields
from granflow.fields import FieldSpec, Quantity
from granflow.scene.blocks.materials import PRESETS
from granflow.scene.blocks.metrics import METRICS
from granflow.schema.messages import selecting_keys
from granflow.units import DIMENSIONS

CSV = """\
# Columns of timeseries.csv

A row is written at every `output.timeseries_interval`, and at the end of the run; if the end follows a row by less than
half of the interval, it replaces this row, so that means do not cover a few steps only. The header contains the name
and the SI unit of each column, such as `kinetic_energy [J]`; a dimensionless column has no brackets. The first columns
are `time [s]` and `stage`. A
column exists only if the scene needs it: the energies of the [energy budget](../explanation/energy.md) with
`output.energy_budget: true`, columns of flow meters, walls and metrics for each of them, with its name after a dot.
The names are also those of `expect:`. At the end of a run with several stages, `stages.csv` has the last row of each.
"""
VTU = """\
# Arrays of VTU files

All values are in SI units, which each file states as field data (in ParaView's *Information* panel): the
array `velocity [m/s]` contains the number 1. A file is one frame; the `.pvd` file of a series lists its frames with
their times. Vectors have the components x, y, z; tensors xx, xy, xz, yx, yy, yz, zx, zy, zz.

meshio writes the files; ParaView and `meshio.read` read them. They are compressed with zlib, unless the scene has
`output.compression: none`: the 192 files of the scene hopper have 31 MB with zlib, written in 1.3 s (1.8 % of the
processor time of the run), and 55 MB without, written in 0.2 s. Frames without particles, contacts or walls contain one
cell without corners, because meshio does not read files without cells.
"""
METRICS_PAGE = """\
# Metrics

`output.metrics` adds these columns to `timeseries.csv`, as `QUANTITY.NAME` with the name of the metric. `result.json`
contains the last values and, as `QUANTITY_mean.NAME`, the means over the rows of the last stage. Definitions and
sources: [coarse graining and metrics](../guides/coarse_graining.md#metrics).
"""
RESULT = """\
# result.json

The numbers of a completed run in SI units. A number that is not finite is `null`. The names are those of `expect:`; a
number of one part (flow meter, wall, metric, group) is `QUANTITY.PART` there.
"""
UNITS = """\
# Units

A number without a unit is in the SI unit, the first of each row. Text with a unit is converted with a single
rounding: `4 mm` is the same floating-point number as `0.004`. `%` is a hundredth. Degrees Celsius
(`20 degC`, `20 °C`) are for single temperatures: columns of files and differences are in K.
"""
PRESET_PAGE = """\
# Material presets

`materials.NAME.preset` supplies the values of a material; values given in the scene have priority.
`pairs.NAME.restitution: {preset: NAME}` supplies sigma and psi of Zhou (2011), Eq. 12, if the preset has them.
"""


def time_series() -> str:
    """Page of the columns of timeseries.csv."""
    groups: Mapping[str, tuple[str, Mapping[str, Quantity]]] = {
        "Whole system": ("", fields.TOTAL_QUANTITIES),
        "Each flow meter": ("METER", fields.FLOW_METER_QUANTITIES),
        "Residence times, in the result": ("METER", fields.RESIDENCE_QUANTITIES),
        "Each outlet": ("OUTLET", fields.OUTLET_QUANTITIES),
        "Each wall in `output.wall_forces`": ("WALL", fields.WALL_FORCE_QUANTITIES),
        "Each servo or free wall": ("WALL", fields.WALL_QUANTITIES),
        "Each wall with a temperature or a heat flux": ("WALL", fields.WALL_FLOW_QUANTITIES),
        "Each wall with wear": ("WALL", fields.WEAR_QUANTITIES),
    }
    sections = [CSV]
    for heading, (part, quantities) in groups.items():
        sections.append(f"## {heading}\n\n{quantity_table(quantities.values(), part)}")
    sections.append("## Each metric\n\nSee [metrics](metrics.md).\n")
    return "\n".join(sections)


def vtu_arrays() -> str:
    """Page of the arrays of VTU files."""
    displayed = [
        each for each in fields.PARTICLE_QUANTITIES.values() if isinstance(each, FieldSpec) and each.displayed
    ]
    contacts = [
        each for name, each in fields.CONTACT_QUANTITIES.items() if name not in ("position_i", "position_j")
    ]
    return "\n".join(
        [
            VTU,
            "## particles_NNNN.vtu\n\nOne vertex per particle, at its center, ordered by id.\n",
            array_table(displayed),
            "## contacts_NNNN.vtu\n\nWith `output.contacts: true`: one line per contact, from center to "
            "center or to the contact point on a wall.\n",
            array_table(contacts),
            "## walls_NNNN.vtu\n\nThe triangles of the walls that are present. The field data (in "
            "ParaView's *Information* panel) name the walls: `wall.belt` contains 2 if the array `wall` is 2 on the belt.\n",
            array_table(fields.WALL_ARRAY_QUANTITIES.values()),
            "## fields_NAME_NNNN.vtu\n\nWith `output.fields`: one value per cell of a grid "
            "([formulas](../guides/coarse_graining.md)).\n",
            array_table(fields.FIELD_QUANTITIES.values()),
        ]
    )


def metrics() -> str:
    """Page of the metrics by kind."""
    sections = [METRICS_PAGE]
    for metric in METRICS:
        kind = selecting_keys(metric)["kind"]
        sections.append(f"## kind: {kind}\n\n{quantity_table(metric.quantities, 'NAME')}")
    return "\n".join(sections)


def result() -> str:
    """Page of the sections of result.json."""
    parts = {
        "flow_meters": fields.FLOW_METER_QUANTITIES,
        "wall_forces": fields.WALL_FORCE_QUANTITIES,
        "insertion": fields.INSERTION_QUANTITIES,
    }
    sections = [RESULT, f"## run\n\n{quantity_table(fields.RUN_QUANTITIES.values())}"]
    sections.append("## timings\n\nWall-clock time of each phase [s]; in `expect:` as `timings.PHASE`.\n")
    sections.append(
        "## totals\n\nThe last values of the [columns of the whole system](timeseries.md#whole-system), and "
        "of outlets and controlled walls.\n"
    )
    for name, quantities in parts.items():
        sections.append(f"## {name}\n\n{quantity_table(quantities.values(), 'PART')}")
    sections.append("## metrics\n\nBy name of the metric; see [metrics](metrics.md).\n")
    sections.append(
        "## expect\n\nA list of `{sentence, met}`, one for each entry of `expect:` in the scene.\n"
    )
    return "\n".join(sections)


def units() -> str:
    """Page of the units of each dimension."""
    rows = [
        (
            each.noun.partition(" ")[2],
            each.si_unit,
            ", ".join(code(name) for name in each.units),
            code(each.example),
        )
        for each in DIMENSIONS.values()
    ]
    return f"{UNITS}\n{table(('quantity', 'SI unit', 'units', 'example'), rows)}"


def presets() -> str:
    """Page of the material presets with their sources."""
    sections = [PRESET_PAGE]
    for name, each in PRESETS.items():
        fit = each.restitution_fit
        rows = [
            ("Young's modulus", f"{each.young_modulus:.4g} Pa"),
            ("Poisson ratio", f"{each.poisson_ratio:g}"),
            ("density", f"{each.density:g} kg/m3"),
            (
                "yield strength",
                f"{each.yield_strength:.4g} Pa" if each.yield_strength else "none: never yields",
            ),
            ("sigma, psi (Zhou 2011, Eq. 12)", f"{fit[0]:g}, {fit[1]:g}" if fit else "none"),
        ]
        sections.append(f"## {name}\n\n{table(('property', 'value'), rows)}\nSource: {each.source}.\n")
    return "\n".join(sections)


def quantity_table(quantities: Iterable[Quantity], part: str = "") -> str:
    """Table of columns; `part`: placeholder of the name of a part after the dot."""
    rows = [
        (code(each.label_of(part) if part else each.label), each.symbol, each.meaning) for each in quantities
    ]
    return table(("column", "symbol", "meaning"), rows)


def array_table(quantities: Iterable[Quantity]) -> str:
    """Table of VTU arrays."""
    rows = [
        (code(each.name), each.unit, f"{each.kind}, {each.file_type}", each.meaning) for each in quantities
    ]
    return table(("array", "unit", "type", "meaning"), rows)
