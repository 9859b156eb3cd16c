"""The mutations of tools/mutate.py: a text of the source, an erroneous replacement, and the tests that must
fail."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutation:
    """One erroneous change. `old` occurs exactly once in `file`; `tests` are arguments of pytest."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


UNITS = "tests/scene/test_unit_values.py::test_every_unit_has_its_si_value"
STEP = "tests/plan/test_time_step.py::"
THEORY = "tests/contact/test_theory.py::"
MOTION = "tests/geometry/test_motion.py::"
CHECKPOINT = "tests/resume/test_checkpoint.py::"
ENERGY = "tests/engine/test_energy_sums.py"
LIMITS = "tests/engine/test_limit_bounds.py::"
OVERLAP = f"{LIMITS}test_the_overlap_limit_holds_for_each_kind_of_contact"
WALL_TIME = "tests/engine/test_wall_velocity_time.py"
SPRINGS = "tests/contact/test_springs.py::"
LAWS = "tests/contact/test_normal_laws.py::test_device_equals_its_numpy_reference"
PERIODIC = "tests/engine/test_periodic.py::"
SHAPES = "tests/geometry/test_shapes.py::test_distance_and_normal_of_elementary_cases"

MUTATIONS = (
    # Units
    Mutation("unit N/cm", "granflow/units.py", "N/cm 100", "N/cm 10", (UNITS,)),
    Mutation("unit GPa", "granflow/units.py", "GPa 1e9", "GPa 1e6", (UNITS,)),
    Mutation("unit rpm", "granflow/units.py", '"rpm": 2 * _PI / 60', '"rpm": _PI / 60', (UNITS,)),
    Mutation("unit t/h", "granflow/units.py", "t/h 1000/3600", "t/h 1/3600", (UNITS,)),
    Mutation("unit pJ", "granflow/units.py", "pJ 1e-12", "pJ 1e-9", (UNITS,)),
    # Theory and limits of the plan
    Mutation(
        "Hertz stiffness",
        "granflow/contact/theory.py",
        "return 4.0 / 3.0 * modulus",
        "return 2.0 / 3.0 * modulus",
        (f"{STEP}test_step_is_a_fraction_of_the_shortest_loading_or_unloading_time",),
    ),
    Mutation(
        "maximum overlap",
        "granflow/contact/theory.py",
        "return (1.25 * mass",
        "return (1.2 * mass",
        (f"{STEP}test_stable_step_holds_for_the_densest_packing",),
    ),
    Mutation(
        "recovery",
        "granflow/contact/theory.py",
        "0.8 * number**2",
        "0.79 * number**2",
        (f"{THEORY}test_recovery_is_the_root_of_equation_8",),
    ),
    Mutation(
        "smallest restitution",
        "granflow/contact/theory.py",
        "np.sqrt(1.25 * k * np.sqrt(largest)",
        "np.sqrt(k * np.sqrt(largest)",
        (f"{STEP}test_least_restitution_follows_from_the_unloading_stiffness_bound",),
    ),
    Mutation(
        "normal modes",
        "granflow/plan/pair_case.py",
        "SLIDING_MODES = 4.0, 20.0",
        "SLIDING_MODES = 2.0, 20.0",
        (f"{STEP}test_stable_step_holds_for_the_densest_packing",),
    ),
    Mutation(
        "sliding modes",
        "granflow/plan/pair_case.py",
        "SLIDING_MODES = 4.0, 20.0",
        "SLIDING_MODES = 4.0, 10.0",
        (f"{STEP}test_friction_reduces_the_stable_step_by_the_rotational_modes",),
    ),
    Mutation(
        "Rayleigh time",
        "granflow/plan/time_step.py",
        "(0.1631 * nu + 0.8766)",
        "(0.1631 * nu + 0.6766)",
        (f"{STEP}test_rayleigh_fraction_limits_the_step",),
    ),
    Mutation(
        "rejection of an unstable step",
        "granflow/plan/time_step.py",
        "if value > stable:",
        "if value > 100.0 * stable:",
        (f"{STEP}test_given_step_above_the_stable_step_is_rejected_with_its_line_and_a_valid_step",),
    ),
    Mutation(
        "one warning per material pair",
        "granflow/plan/pairs.py",
        "if group is not other or group.spec.count > 1 else None",
        "if True else None",
        (f"{STEP}test_contacts_that_cannot_occur_cause_no_warning",),
    ),
    # Motions of walls
    Mutation(
        "start of a vibration",
        "granflow/scene/blocks/motions.py",
        "(np.sin(angle) - np.sin(self.phase))",
        "np.sin(angle)",
        (f"{MOTION}test_vibration_follows_the_formulas_of_the_schema",),
    ),
    Mutation(
        "end of a motion",
        "granflow/scene/blocks/motions.py",
        "np.minimum(times, self.end_time) - self.start_time",
        "times - self.start_time",
        (f"{MOTION}test_wall_is_at_rest_before_the_start_and_after_the_end",),
    ),
    Mutation(
        "rotation matrix",
        "granflow/geometry/motion.py",
        "2 * half_sine**2",
        "half_sine**2",
        (f"{MOTION}test_rotations_stay_orthogonal",),
    ),
    Mutation(
        "wall velocity half a step late",
        "granflow/engine/walls.py",
        "middles = ends - 0.5 * clock.time_step",
        "middles = ends",
        (WALL_TIME,),
    ),
    Mutation(
        "wall velocity half a step early",
        "granflow/engine/walls.py",
        "middles = ends - 0.5 * clock.time_step",
        "middles = ends - clock.time_step",
        (WALL_TIME,),
    ),
    # Lock and checkpoints
    Mutation(
        "shared lock",
        "granflow/io/lock.py",
        "fcntl.LOCK_EX",
        "fcntl.LOCK_SH",
        (f"{CHECKPOINT}test_lock_is_exclusive_and_ends_with_its_process",),
    ),
    Mutation(
        "checksum ignored",
        "granflow/io/checkpoint.py",
        "if found != file.read(len(CHECKSUM_PLACEHOLDER) + 1) or expected not in (None, found.decode()):",
        "if not file.read(len(CHECKSUM_PLACEHOLDER) + 1):",
        (f"{CHECKPOINT}test_each_flipped_bit_is_detected",),
    ),
    Mutation(
        "one checkpoint too many",
        "granflow/io/checkpoint.py",
        "checkpoints(directory)[count:]",
        "checkpoints(directory)[count + 1 :]",
        (f"{CHECKPOINT}test_only_the_newest_checkpoints_are_kept",),
    ),
    # Energy
    Mutation(
        "kinetic energy",
        "granflow/engine/totals.py",
        "kinetic = 0.5 * exact_sum",
        "kinetic = 1.0 * exact_sum",
        (ENERGY,),
    ),
    Mutation(
        "moment of inertia",
        "granflow/engine/totals.py",
        "inertia = sphere_inertia(mass, arrays",
        "inertia = sphere_inertia(1.25 * mass, arrays",
        (ENERGY,),
    ),
    Mutation(
        "work of walls",
        "granflow/engine/totals.py",
        'works = (losses["wall_work"], *',
        'works = (-losses["wall_work"], *',
        (ENERGY,),
    ),
    Mutation(
        "damping in the budget",
        "granflow/engine/totals.py",
        'for name in LOSSES if name != "wall_work")',
        'for name in LOSSES if name not in ("wall_work", "damping_dissipation"))',
        (ENERGY,),
    ),
    Mutation(
        "inserted energy",
        "granflow/engine/totals.py",
        "accounting.removed_energy - accounting.inserted_energy",
        "accounting.removed_energy + accounting.inserted_energy",
        (ENERGY,),
    ),
    # Limits on the device
    Mutation(
        "overlap limit, batched",
        "granflow/engine/batch.py",
        "check_overlap(i, distance_squared, contact_distance, overlap_ratio * radius_min)",
        "check_overlap(i, distance_squared, contact_distance, 4.0 * overlap_ratio * radius_min)",
        (f"{OVERLAP}[batched-pair]",),
    ),
    Mutation(
        "overlap limit, scalar",
        "granflow/engine/contact.py",
        "if overlap > self.max_overlap() * radius_min:",
        "if overlap > 4.0 * self.max_overlap() * radius_min:",
        (f"{OVERLAP}[scalar-pair]",),
    ),
    Mutation(
        "overlap over the larger radius",
        "granflow/engine/contact.py",
        "radius_min = ti.min(radius_min, self.particles.radius[j])",
        "radius_min = ti.max(radius_min, self.particles.radius[j])",
        (f"{OVERLAP}[scalar-pair]",),
    ),
    Mutation(
        "rebuild after a whole skin",
        "granflow/engine/neighbor/sort.py",
        "reach = ti.min(0.5 * rebuild.skin",
        "reach = ti.min(1.0 * rebuild.skin",
        (f"{LIMITS}test_a_displacement_of_half_a_skin_requests_a_rebuild",),
    ),
    Mutation(
        "displacement of a free wall",
        "granflow/engine/wall_dynamics.py",
        "if not step_displacement <= self.travel_limit():",
        "if not step_displacement <= 2.0 * self.travel_limit():",
        (f"{LIMITS}test_the_displacement_of_a_free_wall_has_the_same_limits",),
    ),
    # Laws and kinematics on the device
    Mutation(
        "Hertz force",
        "granflow/contact/normal/hertz.py",
        "elastic = stiffness * ti.sqrt(contact.radius_eff * contact.overlap) * contact.overlap",
        "elastic = stiffness * ti.sqrt(contact.radius_eff * contact.overlap) * contact.radius_eff",
        (LAWS,),
    ),
    Mutation(
        "history of the maximum overlap",
        "granflow/contact/normal/zhou.py",
        "history_new.overlap_max = ti.max(overlap, overlap_max)",
        "history_new.overlap_max = overlap",
        (LAWS,),
    ),
    Mutation(
        "Mindlin stiffness",
        "granflow/contact/law.py",
        "return 8.0 * constants.shear_modulus_eff",
        "return 4.0 * constants.shear_modulus_eff",
        (WALL_TIME,),
    ),
    Mutation(
        "Coulomb limit",
        "granflow/contact/tangential/spring.py",
        "ti.select(square > cap * cap,",
        "ti.select(square > 2.0 * cap * cap,",
        (f"{SPRINGS}test_spring_force_is_limited_to_the_friction_limit",),
    ),
    Mutation(
        "work of the tangential spring",
        "granflow/contact/tangential/spring.py",
        "0.5 * (stiffness_before * rotated - force)",
        "0.5 * (stiffness_before * rotated + force)",
        (f"{SPRINGS}test_sticking_spring_of_a_steady_contact_has_no_loss",),
    ),
    Mutation(
        "effective mass and radius",
        "granflow/engine/pair.py",
        "return one * other / (one + other)",
        "return 0.5 * one * other / (one + other)",
        ("tests/physics/test_chung_ooi.py::test_elastic_collisions_reach_the_overlap_force_and_duration",),
    ),
    Mutation(
        "torque on the partner",
        "granflow/contact/law.py",
        "torque_partner=-kinematics.arm_partner * moment",
        "torque_partner=kinematics.arm_partner * moment",
        ("tests/engine/test_conservation.py::test_momentum_of_a_closed_system_is_conserved_to_rounding",),
    ),
    # Neighbor list, periodic images, walls
    Mutation(
        "minimum image at the lower side",
        "granflow/engine/box.py",
        "ti.select(branch[axis] < -half, widths[axis]",
        "ti.select(branch[axis] < -widths[axis], widths[axis]",
        (f"{PERIODIC}test_neighbor_list_holds_exactly_the_candidate_pairs_of_minimum_images",),
    ),
    Mutation(
        "neighbors of the next index",
        "granflow/engine/neighbor/list.py",
        "if (j > i) | (j < owner.first)",
        "if (j > i + 1) | (j < owner.first)",
        ("tests/engine/test_neighbor_list.py::test_neighbor_list_holds_exactly_the_candidate_pairs",),
    ),
    Mutation(
        "plane",
        "granflow/scene/blocks/walls/half_space.py",
        "(x - numbers.point).dot(numbers.normal)",
        "(x + numbers.point).dot(numbers.normal)",
        (SHAPES,),
    ),
    Mutation(
        "radius of a cylinder",
        "granflow/scene/blocks/walls/revolved.py",
        "outward = r - numbers.start_r",
        "outward = r - 0.5 * numbers.start_r",
        (SHAPES,),
    ),
)
