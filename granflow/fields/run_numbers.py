"""Numbers of a run, of its stages, meters, outlets, groups and walls; units of all numbers."""

from granflow.fields.metrics import METRIC_QUANTITIES
from granflow.fields.quantity import Quantity, by_name

_STATE_QUANTITIES = by_name(
    (
        Quantity("particle_count", "N", "1", "particles present"),
        Quantity("inserted_count", "", "1", "particles inserted since the start"),
        Quantity("queued_count", "", "1", "particles due but queued for lack of space; only with insertion"),
        Quantity("deleted_count", "", "1", "particles deleted at the domain boundary or by outlets"),
        Quantity("deleted_mass", "", "kg", "mass of the particles deleted at the domain boundary or by outlets"),
        Quantity("contact_count", "Nc", "1", "contacts between particles and with walls, each counted once"),
        Quantity("wall_contact_count", "", "1", "contacts of particles with walls"),
        Quantity("kinetic_energy", "Ek", "J", "translational kinetic energy"),
        Quantity("rotational_energy", "Er", "J", "rotational kinetic energy"),
        Quantity("overlap_mean", "", "1", "mean overlap of the contacts over the radius"),
        Quantity("overlap_largest", "", "1", "largest overlap of the contacts over the radius"),
        Quantity("coordination_number", "Z", "1", "mean number of contacts with particles per mobile particle"),
        Quantity("liquid_film_volume", "", "m3", "liquid in the films of the particles; only with liquid transfer"),
        Quantity("liquid_bridge_volume", "", "m3", "liquid in the bridges; only with liquid transfer"),
        Quantity("shear_strain", "", "1", "shear strain of the box since the start"),
    )
)


ENERGY_BUDGET_QUANTITIES = by_name(
    (
        Quantity("gravitational_energy", "Eg", "J", "potential energy in gravity, zero at the origin"),
        Quantity("elastic_energy", "Ee", "J", "recoverable energy stored in contacts"),
        Quantity("plastic_dissipation", "", "J", "energy dissipated by unloading steeper than loading"),
        Quantity("friction_dissipation", "", "J", "energy dissipated by sliding friction"),
        Quantity("rolling_dissipation", "", "J", "energy dissipated by rolling and twisting friction"),
        Quantity("damping_dissipation", "", "J", "energy dissipated by damping: in contacts, and of all motion"),
        Quantity("wall_work", "", "J", "work of moving walls and belts on the particles"),
        Quantity(
            "boundary_work",
            "",
            "J",
            "work at periodic boundaries: of gravity on wrapped particles, and of moving images",
        ),
        Quantity("external_work", "", "J", "work of the forces from functions of a program on the particles"),
        Quantity("free_wall_energy", "", "J", "kinetic energy of free walls"),
        Quantity("free_wall_work", "", "J", "work of gravity, damping and the prescribed force on free walls"),
        Quantity("removed_energy", "", "J", "energy of deleted minus energy of inserted particles"),
        Quantity(
            "energy_error",
            "",
            "1",
            "residual of the energy budget over the largest energy input so far",
        ),
    )
)
"""Totals that require `output.energy_budget`."""


TOTAL_QUANTITIES = {**_STATE_QUANTITIES, **ENERGY_BUDGET_QUANTITIES}
"""Numbers of Snapshot.totals and columns of the time series."""


FLOW_METER_QUANTITIES = by_name(
    (
        Quantity("flow_mass", "", "kg", "net mass through the meter since the start"),
        Quantity("flow_count", "", "1", "net number of particles through the meter since the start"),
        Quantity("mass_flow", "", "kg/s", "mass flow rate: between rows in the time series, steady mean in the result"),
        Quantity(
            "residence_time",
            "",
            "s",
            "mean time from insertion to passage of the particles that passed forward: since the previous row in the "
            "time series, of all in the result",
        ),
        Quantity("residence_time_deviation", "", "s", "standard deviation of these times, in the result"),
    )
)
"""Numbers of each flow meter."""


OUTLET_QUANTITIES = by_name(
    (
        Quantity("outlet_count", "", "1", "particles deleted by the outlet since the start"),
        Quantity("outlet_mass", "", "kg", "mass deleted by the outlet since the start"),
    )
)
"""Numbers of each outlet."""


INSERTION_QUANTITIES = by_name(
    (
        Quantity("inserted_count", "", "1", "inserted particles of the group"),
        Quantity("inserted_mass", "", "kg", "mass of the inserted particles of the group"),
        Quantity("not_inserted_count", "", "1", "particles of the group not inserted at the end"),
    )
)
"""Numbers of each inserted particle group, in the result."""


WALL_FORCE_QUANTITIES = by_name(
    (
        Quantity("wall_force_x", "Fx", "N", "x component of the force of the particles on a wall, time average"),
        Quantity("wall_force_y", "Fy", "N", "y component"),
        Quantity("wall_force_z", "Fz", "N", "z component"),
        Quantity("wall_torque_x", "Mx", "N m", "x component of the torque about the reference point of the wall"),
        Quantity("wall_torque_y", "My", "N m", "y component"),
        Quantity("wall_torque_z", "Mz", "N m", "z component"),
        Quantity("wall_pressure", "p", "Pa", "sum of the normal forces of the particles over the area of the wall"),
        Quantity("wall_force", "F", "N", "magnitude of the mean force, in the result"),
        Quantity("wall_torque", "M", "N m", "magnitude of the mean torque, in the result"),
        Quantity("wall_force_largest", "", "N", "largest magnitude of the force in a row, in the result"),
        Quantity("wall_pressure_largest", "", "Pa", "largest pressure in a row, in the result"),
        *(
            Quantity(
                f"wall_{name}_{axis}_last", "", unit, f"{axis} component of the {name} in the last row, in the result"
            )
            for name, unit in (("force", "N"), ("torque", "N m"))
            for axis in "xyz"
        ),
        Quantity("wall_pressure_last", "", "Pa", "pressure in the last row, in the result"),
    )
)
"""Numbers of each measured wall."""


WALL_QUANTITIES = by_name(
    (
        Quantity("wall_displacement", "", "m", "displacement of a controlled wall along its direction, of all motions"),
        Quantity("wall_velocity", "", "m/s", "velocity of a controlled wall along its direction, of all motions"),
    )
)
"""Numbers of each controlled wall."""


RUN_QUANTITIES = by_name(
    (
        Quantity("simulated_time", "t", "s", "simulated time at the end"),
        Quantity("step_count", "", "1", "number of completed steps"),
        Quantity("time_step", "dt", "s", "time step"),
        Quantity("rebuild_count", "", "1", "rebuilds of the neighbor list"),
        Quantity("wall_clock", "", "s", "wall-clock time of the whole run, including compilation"),
        Quantity("steps_per_second", "", "1/s", "steps per second of computing time: without compilation and output"),
        Quantity("particle_steps_per_second", "", "1/s", "particle-steps per second of computing time"),
        Quantity(
            "steps_per_second_of_wall_clock", "", "1/s", "steps per second of `wall_clock`: with compilation and output"
        ),
    )
)
"""Numbers of a whole run, in the result."""


def unit_of(name: str) -> str:
    """Return the unit of a number of a run; "" if it is dimensionless or unknown.

    name:  name of a total or of a number of the run, or `QUANTITY.PART` as in `mass_flow.outlet` and `timings.forces`
    """
    base, _, part = name.partition(".")
    if base == "timings" and part:
        return "s"
    parts = {**FLOW_METER_QUANTITIES, **WALL_FORCE_QUANTITIES, **WALL_QUANTITIES, **METRIC_QUANTITIES}
    parts |= {**INSERTION_QUANTITIES, **OUTLET_QUANTITIES}
    known = parts if part else {**TOTAL_QUANTITIES, **RUN_QUANTITIES}
    return known[base].unit if base in known and known[base].unit != "1" else ""
