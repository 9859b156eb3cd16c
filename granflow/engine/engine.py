"""Device interface of the simulation: insert particles, set walls, advance, take a snapshot."""

from collections.abc import Sequence
from math import ceil, pi

import numpy as np

from granflow.engine.accounting import Accounting, energy_budget_totals, mechanical_energy
from granflow.engine.backend import Backend
from granflow.engine.diagnosis import diagnose
from granflow.engine.force.contact_output import ContactOutput
from granflow.engine.force.contact_statistics import ContactStatistics
from granflow.engine.force.max_impact_velocity import MaxImpactVelocity
from granflow.engine.force.wall_forces import wall_impulses
from granflow.engine.frozen_masks import mobility_mask
from granflow.engine.host_copy import HostCopy
from granflow.engine.limits import ABORT_LEFT_DOMAIN, Diagnosis
from granflow.engine.stability_monitor import StabilityMonitor, largest_speed
from granflow.engine.state import State
from granflow.engine.stepper import Stepper, Timing
from granflow.engine.wall_dynamics import controlled_displacements, controlled_totals
from granflow.geometry.motion import Motion, pose
from granflow.particles.generate import ParticleData
from granflow.plan.adaptive_time_step import STEPS_BETWEEN_UPDATES
from granflow.plan.outlets import outlet_of
from granflow.plan.plan import Plan
from granflow.snapshot import Snapshot, WallPose

TIME_TOLERANCE = 1e-6
"""Tolerance for reaching a requested time, as a fraction of the time step."""


class Engine:
    """One plan on one backend; the clock of the state counts steps and time.

    Typical order: `insert`, `set_walls` and `refresh`, then `advance` and `snapshot` repeatedly; again `refresh` after
    particles or walls have changed; `free` at the end.
    """

    def __init__(self, plan: Plan, backend: Backend) -> None:
        self.plan = plan
        self.state = State(plan, backend)
        self.stepper = Stepper(self.state, self._on_deleted)
        self._build_host_access()
        self.accounting = Accounting(outlets={outlet.name: [0.0, 0.0] for outlet in plan.outlets})
        self.stability_monitor = StabilityMonitor(plan)
        self.steps_since_update = 0
        self._gravity = np.array(plan.gravity)
        self._walls_changed = False
        self._started = False

    def _build_host_access(self) -> None:
        """Build the kernels that access fields from the host; repeated after fields are replaced by larger ones.

        Kernels refer to the fields that exist when they are built.
        """
        self._host_access_version = self.timing.growth_count
        self._host_copy = HostCopy(self.state)
        self._contact_statistics = ContactStatistics(self.state)
        self._contact_output: ContactOutput | None = None
        self._max_impact_velocity = MaxImpactVelocity(self.state) if self.plan.adaptive_time_step is not None else None

    def _update_host_access(self) -> None:
        """Build the host access again if fields have been replaced."""
        if self._host_access_version != self.timing.growth_count:
            self._free_host_access()
            self._build_host_access()

    def _free_host_access(self) -> None:
        for each in (self._contact_statistics, self._contact_output, self._max_impact_velocity):
            if each is not None:
                each.block.free()

    @property
    def host_copy(self) -> HostCopy:
        """Copies between host arrays and particle fields."""
        self._update_host_access()
        return self._host_copy

    @property
    def contact_statistics(self) -> ContactStatistics:
        """Kernels of the contact statistics."""
        self._update_host_access()
        return self._contact_statistics

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.state.clock.time

    @property
    def step_count(self) -> int:
        """Number of completed steps."""
        return self.state.clock.step_count

    @property
    def time_step(self) -> float:
        """Present time step [s]."""
        return self.state.clock.time_step

    @property
    def mean_time_step(self) -> float:
        """Time step [s]; with an adaptive time step, the mean over all completed steps."""
        is_adaptive = self.plan.adaptive_time_step is not None and self.step_count > 0
        return self.time / self.step_count if is_adaptive else self.plan.time_step

    def steps_to(self, time: float) -> int:
        """Number of steps of the present length that end at this time [s] or just after it."""
        return ceil((time - self.time) / self.time_step - TIME_TOLERANCE)

    def reached(self, time: float) -> bool:
        """True if the present time is the step nearest to this time [s], or later."""
        return self.time >= time - 0.5 * self.time_step

    @property
    def timing(self) -> Timing:
        """Wall-clock time [s] by phase."""
        return self.stepper.timing

    @property
    def aborted(self) -> bool:
        """True if the run exceeded a limit."""
        return bool(self.stepper.abort_code)

    @property
    def diagnosis(self) -> Diagnosis | None:
        """Diagnosis of an aborted run, computed again at every call; None if the run has not aborted."""
        code = self.stepper.abort_code
        if not code:
            return None
        particle = int(self.state.control.abort_particle[0])
        return diagnose(code, particle, self.state, self.host_copy, self.time, self._started)

    def insert(self, new: ParticleData) -> None:
        """Insert particles at the present time; the next `refresh` computes their forces.

        new:  k particles; material numbers of the scene, velocities [m/s] at the present time

        Ids continue the count of inserted particles. After the start, velocities are shifted half a step back by
        gravity, as the leapfrog scheme requires. The mechanical energy counts as inserted.
        """
        if not len(new):
            return
        plan, accounting, count = self.plan, self.accounting, len(new)
        density = np.array([solid.density for solid in plan.solids.values()])
        number = np.array([self._plan_number(name) for name in plan.solids])
        fixed = np.array([group.fixed for group in plan.groups])[new.group]
        arrays = {
            "id": accounting.inserted_count + np.arange(count),
            "material": number[new.material],
            "fixed": fixed.astype(np.int32),
            "radius": new.radius,
            "mass": 4.0 / 3.0 * pi * new.radius**3 * density[new.material],
            "position": new.position,
            "velocity": new.velocity,
            "angular_velocity": new.angular_velocity,
        }
        accounting.inserted_energy += sum(mechanical_energy(arrays, self._gravity))
        if self._started:
            velocity_gain = 0.5 * self.time_step * self._gravity
            arrays["velocity"] = new.velocity - mobility_mask(arrays)[:, None] * velocity_gain
        self.host_copy.append(arrays)
        accounting.inserted_count += count
        accounting.material.append(new.material)
        accounting.group.append(new.group)

    def set_walls(self, present: Sequence[bool], motions: Sequence[Sequence[Motion]]) -> None:
        """Set which walls are present and their motions; takes effect with the next `refresh`.

        present:  one entry per wall of the plan
        motions:  motions of each wall
        """
        self.state.wall_motions = tuple(tuple(each) for each in motions)
        for index, is_present in enumerate(present):
            self.state.walls.present[index] = int(is_present)
            pivot = pose(self.state.wall_motions[index], np.array([self.time])).pivot
            self.state.walls.pivot[index] = pivot.tolist()
        self._walls_changed = True

    def refresh(self) -> None:
        """Rebuild the neighbor list and compute the forces after particles or walls were added or removed.

        The first call also shifts velocities half a step back, as the leapfrog scheme requires. If a wall appears
        between particles, or disappears, the energy of its contacts counts as inserted or removed.
        """
        counts_energy = self.plan.features.energy_budget and self._walls_changed
        before = self._contact_energy() if counts_energy else 0.0
        self.stepper.refresh(self.step_count)
        if counts_energy:
            self.accounting.inserted_energy += self._contact_energy() - before
        self._walls_changed = False
        if not self._started and not self.aborted:
            self._started = True
            self.host_copy.kick(-0.5 * self.time_step)
        self._update_time_step()

    def _contact_energy(self) -> float:
        """Elastic energy and plastic dissipation [J] of the present contacts."""
        self.stepper.place_walls(self.step_count)
        measured = self.contact_statistics.measure()
        return measured["elastic_energy"] + measured["plastic_dissipation"]

    def advance(self, steps: int) -> None:
        """Take `steps` steps; fewer after an abort, a stop request or a change of the time step.

        `step_count`, `time` and `aborted` show the result.
        """
        clock, before = self.state.clock, self.time_step
        wanted = clock.step_count + steps
        while clock.step_count < wanted and self.time_step == before and not (self.aborted or self.stepper.interrupted):
            allowed = wanted - clock.step_count
            if self.plan.adaptive_time_step is None:
                clock.step_count += self.stepper.advance(allowed, clock.step_count)
            else:
                self._advance_to_update(min(allowed, STEPS_BETWEEN_UPDATES - self.steps_since_update))

    def _advance_to_update(self, steps: int) -> None:
        """Take up to `steps` steps; update the time step if an update is due."""
        rebuilds = self.timing.rebuild_count
        done = self.stepper.advance(steps, self.state.clock.step_count)
        self.state.clock.step_count += done
        self.steps_since_update += done
        if self.steps_since_update >= STEPS_BETWEEN_UPDATES or self.timing.rebuild_count > rebuilds:
            self._update_time_step()

    def _update_time_step(self) -> None:
        """Update an adaptive time step for the present state.

        Velocities are half a step behind; they are shifted to half a step of the new length.
        """
        adaptive_time_step = self.plan.adaptive_time_step
        self.steps_since_update = 0
        if adaptive_time_step is None or self.aborted:
            return
        self.stepper.place_walls(self.step_count)
        self._update_host_access()
        assert self._max_impact_velocity is not None
        step = adaptive_time_step.step_for(
            self._max_impact_velocity.measure(), float(np.linalg.norm(self._gravity)) * self.time_step
        )
        if step != self.time_step:
            self.host_copy.kick(0.5 * (self.time_step - step))
            self.state.clock.change(step)

    def mark_resumed(self, steps_since_update: int) -> None:
        """Continue a resumed run: clock, particles, walls and contacts have been restored."""
        self.steps_since_update = steps_since_update
        self._started, self._walls_changed = True, False

    def mean_kinetic_energy(self) -> float:
        """Mean translational and rotational kinetic energy [J] per particle that is not fixed."""
        arrays = self.synchronized(("mass", "radius", "position", "velocity", "angular_velocity", "force", "torque"))
        kinetic, rotational, _ = mechanical_energy(arrays, self._gravity)
        return (kinetic + rotational) / max(mobility_mask(arrays).sum(), 1.0)

    def snapshot(self, stage: str, quantities: frozenset[str]) -> Snapshot:
        """Snapshot of the present state, read-only arrays in SI units.

        stage:       name of the present stage
        quantities:  subset of particles, contacts, walls and totals, as for observers

        With walls alone, `totals` contains the particle count only, and no contact statistics are computed.
        """
        if quantities <= {"walls"}:
            count = {"particle_count": float(self.state.count)}
            impulses = wall_impulses(self.state)
            return Snapshot(self.time, self.step_count, stage, {}, None, self.wall_poses(), count, impulses)
        self.stepper.place_walls(self.step_count)
        measured = self.contact_statistics.measure()
        names = ("id", "radius", "mass", "position", "velocity", "angular_velocity", "force", "torque", "coordination")
        arrays = self.synchronized(names)
        totals = self._totals(arrays, measured)
        arrays["position"], arrays["velocity"] = self.plan.periodic_box.wrap_with_velocity(
            arrays["position"], arrays["velocity"], self.time
        )
        particles = self._particle_arrays(arrays) if "particles" in quantities else {}
        contacts = self._contact_arrays(arrays) if "contacts" in quantities else None
        poses, impulses = self.wall_poses(), wall_impulses(self.state)
        return Snapshot(self.time, self.step_count, stage, particles, contacts, poses, totals, impulses)

    def wall_poses(self) -> dict[str, WallPose]:
        """Present pose of every wall by name."""
        found, displacements = {}, controlled_displacements(self.state)
        for index, wall in enumerate(self.plan.walls):
            poses = pose(self.state.wall_motions[index], np.array([self.time]))
            present = bool(self.state.walls.present[index])
            found[wall.name] = WallPose(present, poses.offset[0] + displacements[index], poses.rotation[0], poses.pivot)
        return found

    def free(self) -> None:
        """Free the device memory."""
        self._free_host_access()
        self.state.free()

    def _plan_number(self, material: str) -> int:
        return self.plan.materials.index(material) if material in self.plan.materials else 0

    def _on_deleted(self, first: int, last: int) -> None:
        """Add the deleted particles to the accounting: indices `first` to `last`, exclusive, in device order.

        With `on_exit: error`, sets the abort code if one of them left the domain.
        """
        arrays = self.host_copy.copy_to_host(
            ("id", "mass", "radius", "position", "velocity", "angular_velocity", "fixed"), first, last
        )
        left_domain = self._count_outlets(arrays) < 0
        if self.plan.domain.on_exit == "error" and left_domain.any():
            self.state.control.abort[0] = ABORT_LEFT_DOMAIN
            self.state.control.abort_particle[0] = int(arrays["id"][left_domain].min())
        kinetic, rotational, potential = mechanical_energy(arrays, self._gravity)
        self.accounting.deleted_count += last - first
        self.accounting.deleted_mass += float(arrays["mass"].sum(dtype=float))
        self.accounting.removed_energy += kinetic + rotational + potential
        self.accounting.removed_kinetic_energy += kinetic + rotational

    def _count_outlets(self, arrays: dict[str, np.ndarray]) -> np.ndarray:
        """Index of the outlet of each deleted particle (n,), -1 for none; adds counts and masses to the accounting."""
        position, outlets = arrays["position"], self.plan.outlets
        if not outlets:
            return np.full(len(position), -1)
        checked_axes = [axis for axis in range(3) if self.plan.domain.on_exit != "expand"]
        low, high = self.plan.domain_low[checked_axes], self.plan.domain_high[checked_axes]
        in_domain = np.all((position[:, checked_axes] >= low) & (position[:, checked_axes] <= high), axis=1)
        outlet_index = outlet_of(outlets, position.astype(float), in_domain)
        for index, outlet in enumerate(outlets):
            by_outlet = outlet_index == index
            self.accounting.outlets[outlet.name][0] += float(by_outlet.sum())
            self.accounting.outlets[outlet.name][1] += float(arrays["mass"][by_outlet].sum(dtype=float))
        return outlet_index

    def synchronized(self, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Fields on the host in device order, with velocities and angular velocities at the time of the positions.

        names:    particle fields, with mass, velocity, force and, with rotation, radius, angular_velocity, torque
        Returns:  arrays (n,) or (n, 3); fields that the scene does not have are absent

            v(t) = v(t - dt/2) + dt F(t) / (2 m),   w(t) = w(t - dt/2) + dt M(t) / (2 I),   I = (2/5) m R^2

        Before the first step they are the initial values: a run that aborts there has not shifted them.
        """
        arrays = self.host_copy.copy_to_host((*names, "fixed"))
        if not self._started:
            return arrays
        half = 0.5 * self.time_step * mobility_mask(arrays)[:, None]
        mass = arrays["mass"].astype(float)[:, None]
        arrays["velocity"] = arrays["velocity"] + half * arrays["force"] / mass
        if "angular_velocity" in arrays:
            inertia = 0.4 * mass * arrays["radius"].astype(float)[:, None] ** 2
            arrays["angular_velocity"] = arrays["angular_velocity"] + half * arrays["torque"] / inertia
        return arrays

    def _particle_arrays(self, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Arrays of PARTICLE_QUANTITIES, ordered by id; zeros for angular velocity and torque without rotation."""
        order = np.argsort(arrays["id"], kind="stable")
        found = {name: values[order] for name, values in arrays.items()}
        found["id"] = found["id"].astype(np.int64)
        found["coordination_number"] = found.pop("coordination")
        for name in ("material", "group"):
            found[name] = self.accounting.by_id(name, found["id"])
        for name in ("angular_velocity", "torque"):
            found.setdefault(name, np.zeros_like(found["velocity"]))
        return found

    def _contact_arrays(self, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Arrays of CONTACT_QUANTITIES, from the fields (n,) or (n, 3) in device order."""
        self._update_host_access()
        if self._contact_output is None:
            self._contact_output = ContactOutput(self.state)
        return self._contact_output.take(arrays)

    def _totals(self, arrays: dict[str, np.ndarray], measured: dict[str, float]) -> dict[str, float]:
        """Totals of the present state by name, SI units; also checks the stability."""
        accounting, count = self.accounting, self.state.count
        energies = mechanical_energy(arrays, self._gravity)
        contacts, free = measured["contact_count"], mobility_mask(arrays)
        totals = {
            "particle_count": float(count),
            "inserted_count": float(accounting.inserted_count),
            "deleted_count": float(accounting.deleted_count),
            "deleted_mass": accounting.deleted_mass,
            "contact_count": contacts,
            "kinetic_energy": energies[0],
            "rotational_energy": energies[1],
            "overlap_mean": measured["overlap_sum"] / contacts if contacts else 0.0,
            "overlap_largest": measured["overlap_largest"],
            "coordination_number": float(free @ arrays["coordination"]) / max(free.sum(), 1.0),
        }
        if self.plan.features.lees_edwards:
            totals["shear_strain"] = self.plan.periodic_box.strain(self.time)
        if accounting.queued_count is not None:
            totals["queued_count"] = float(accounting.queued_count)
        for name, (outlet_count, outlet_mass) in accounting.outlets.items():
            totals |= {f"outlet_count.{name}": outlet_count, f"outlet_mass.{name}": outlet_mass}
        if self.plan.features.energy_budget:
            totals |= energy_budget_totals(self.state, accounting, energies, measured)
        totals |= controlled_totals(self.state)
        self.stability_monitor.check(self.time, energies, accounting, totals, largest_speed(arrays["velocity"]))
        return totals
