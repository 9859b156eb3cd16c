"""Device interface of the simulation: insert particles, set walls, advance, take a snapshot."""

import weakref
from collections.abc import Mapping, Sequence
from math import ceil
from typing import Any

import numpy as np

from granflow.engine.accounting import Accounting, mechanical_energy
from granflow.engine.backend import Backend
from granflow.engine.changes import REMOVED_BELOW, write_particles
from granflow.engine.diagnosis import diagnose
from granflow.engine.force.contact_output import ContactOutput
from granflow.engine.force.contact_statistics import ContactStatistics
from granflow.engine.force.damping import write_damping
from granflow.engine.force.max_impact_velocity import MaxImpactVelocity
from granflow.engine.force.wall_forces import wall_impulses
from granflow.engine.frozen_masks import mobility_mask
from granflow.engine.gpu_stepper import GpuStepper
from granflow.engine.host_copy import append_particles, copy_to_host
from granflow.engine.host_particles import HostParticles
from granflow.engine.insertion import new_particle_arrays
from granflow.engine.integrate import build_kick
from granflow.engine.limits import ABORT_LEFT_DOMAIN, NO_PARTICLE, Diagnosis
from granflow.engine.particle_sums import ParticleSums, device_sums, host_sums
from granflow.engine.saved_sums import load_sums, load_wall_dynamics, saved_sums, saved_wall_dynamics
from granflow.engine.snapshots import ordered_particles, wall_poses
from granflow.engine.stability_monitor import StabilityMonitor
from granflow.engine.state import FreedState, State
from granflow.engine.state_cache import return_state, take_state
from granflow.engine.stepper import Stepper
from granflow.engine.totals import ended_contacts_dissipation, totals_of
from granflow.fields import PARTICLE_QUANTITIES
from granflow.geometry.motion import Motion, pose
from granflow.particles.particle_data import ParticleData
from granflow.plan.adaptive_time_step import STEPS_BETWEEN_UPDATES
from granflow.plan.outlets import outlet_of
from granflow.plan.plan import Plan
from granflow.snapshot import Snapshot

TIME_TOLERANCE = 1e-6
"""Tolerance for reaching a requested time, as a fraction of the time step."""

DELETED_FIELDS = ("id", "mass", "radius", "position", "velocity", "angular_velocity", "fixed")
"""Fields of deleted particles that their accounting needs."""

MOTION = ("mass", "radius", "position", "velocity", "angular_velocity", "force", "torque")
"""Fields that determine the mechanical energy at the time of the positions."""


class Engine:
    """One plan on one backend; the clock of the state counts steps and time.

    Typical order: `insert`, `set_walls` and `refresh`, then `advance` and `observe` repeatedly; again `refresh` after
    particles or walls have changed; `free` at the end.
    """

    def __init__(self, plan: Plan, backend: Backend) -> None:
        self.plan = plan
        self.state: State = take_state(plan, backend)
        self._return_state = weakref.finalize(self, return_state, self.state)
        self._return_state.atexit = False
        self.stepper = self._new_stepper()
        self.timing = self.stepper.timing
        self.accounting = Accounting(outlets={outlet.name: [0.0, 0.0] for outlet in plan.outlets})
        self.stability_monitor = StabilityMonitor(plan)
        self.steps_since_update = 0
        self._gravity = np.array(plan.gravity)
        self._walls_changed = False
        self._started = False
        self.energy_before_change: float | None = None
        self._counts_contacts = False

    def _new_stepper(self) -> Stepper:
        """The stepper of the state."""
        kind = Stepper if self.state.backend.on_cpu else GpuStepper
        return kind(self.state, self._on_deleted)

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
    def particle_count(self) -> int:
        """Number of particles, of all ranks."""
        return self.state.count

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
    def is_changed(self) -> bool:
        """True if particles or walls have changed since the last `refresh`; see `engine.changes`."""
        return self._walls_changed or self.energy_before_change is not None

    @property
    def has_started(self) -> bool:
        """True if velocities are half a step behind the positions."""
        return self._started

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
        return diagnose(code, particle, self.state, self.time, self._started)

    def insert(self, new: ParticleData) -> None:
        """Insert particles at the present time; the next `refresh` computes their forces.

        new:  k particles; material numbers of the scene, velocities [m/s] at the present time

        Ids continue the count of inserted particles. After the start, velocities are shifted half a step back by
        gravity, as the leapfrog scheme requires. The mechanical energy counts as inserted.
        """
        if not len(new):
            return
        arrays = new_particle_arrays(self.plan, new, self.accounting.inserted_count)
        energy = sum(mechanical_energy(arrays, self._gravity))
        self.accounting.insert(new.material, new.group, energy)
        if self.energy_before_change is not None:
            self.energy_before_change += energy
        if self._started:
            velocity_gain = 0.5 * self.time_step * self._gravity
            arrays["velocity"] = new.velocity - mobility_mask(arrays)[:, None] * velocity_gain
        self._append(arrays | {"velocity_synchronized": arrays["velocity"]})

    def _append(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Append particles on the device, see `append_particles`."""
        append_particles(self.state, arrays)

    def restart(self, new: ParticleData, time_step: float | None = None) -> None:
        """Replace all particles, with initial forces and without contact history; also after an abort.

        new:        particles at the present time
        time_step:  of all further steps [s]; None: the present one
        """
        state = self.state
        state.count = 0
        state.control.abort[0], state.control.abort_particle[0] = 0, NO_PARTICLE
        for row in (state.neighbors.list_begin, state.neighbors.list_end):
            row.fill(0)
        if time_step is not None:
            state.clock.change(time_step)
        self.accounting = Accounting(outlets={outlet.name: [0.0, 0.0] for outlet in self.plan.outlets})
        self._started, self.energy_before_change = False, None
        self.insert(new)
        self.refresh()

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

    def set_stage(self, stage: str) -> None:
        """Set the stage, which may have damping; takes effect with the next forces."""
        write_damping(self.state, stage)

    def refresh(self) -> None:
        """Rebuild the neighbor list and compute the forces after particles or walls were added or removed.

        The first call also shifts velocities half a step back, as the leapfrog scheme requires. If a wall appears
        between particles, or disappears, the energy of its contacts counts as inserted or removed; after a change of
        the particles, the change of all energies.
        """
        before, energy = self.energy_before_change, self.stored_energy
        if before is None and self.plan.features.energy_budget and self._walls_changed:
            before, energy = self._contact_energy(), self._contact_energy
        self.stepper.discard_poses()
        self.stepper.refresh(self.step_count, velocities_lag=self._started)
        if before is not None:
            self.accounting.inserted_energy += energy() - before
        self._walls_changed, self.energy_before_change = False, None
        if not self._started and not self.aborted:
            self._started = True
            self._kick(-0.5 * self.time_step)
        self._update_time_step()

    def _kick(self, time: float) -> None:
        """Change the velocities by the present forces during `time` [s]; backwards if negative."""
        self.state.built(build_kick)(self.state.count, time)

    def _contact_energy(self) -> float:
        """Elastic energy and plastic dissipation [J] of the present contacts."""
        measured = self.state.built(ContactStatistics).measure(self.stepper.place_walls(self.step_count))
        return measured["elastic_energy"] + measured["plastic_dissipation"]

    def stored_energy(self) -> float:
        """Mechanical energy [J] of the particles and, if contacts existed before a change, energies of contacts.

        The latter are the elastic energy and the plastic dissipation of present contacts, and with the energy budget
        that of ended ones.
        """
        return self._stored_energy(self.synchronized(MOTION))

    def _stored_energy(self, arrays: Mapping[str, np.ndarray]) -> float:
        """`stored_energy` with the fields MOTION at the time of the positions."""
        energy = sum(mechanical_energy(arrays, self._gravity))
        if self._counts_contacts:
            energy += self._contact_energy() + ended_contacts_dissipation(self.state)
        return energy

    def begin_change(self) -> None:
        """Prepare a change of the particles: shift all velocities to the time of the positions.

        The next `refresh` shifts them back, and counts the change of all energies as inserted.
        """
        if self.energy_before_change is not None:
            return
        self._counts_contacts = self.timing.rebuild_count > 0
        arrays = self.synchronized(MOTION)
        self.energy_before_change = self._stored_energy(arrays)
        if self._started:
            motion = {name: values for name, values in arrays.items() if name in ("velocity", "angular_velocity")}
            write_particles(self.state, np.arange(self.state.count), motion)
            self._started = False

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
        self.stepper.discard_poses()
        self.stepper.place_walls(self.step_count)
        step = adaptive_time_step.step_for(
            self.state.built(MaxImpactVelocity).measure(), float(np.linalg.norm(self._gravity)) * self.time_step
        )
        if step != self.time_step:
            self._kick(0.5 * (self.time_step - step))
            self.state.clock.change(step)
            self.stepper.discard_poses()

    def saved_particles(self) -> HostParticles:
        """All particles with their contact histories, for a checkpoint."""
        return self.stepper.saved_particles()

    def saved_sums(self) -> dict[str, Any]:
        """Sums and force-controlled walls, for a checkpoint."""
        return {"energy_budget": saved_sums(self.state), "wall_dynamics": saved_wall_dynamics(self.state)}

    def restore(self, saved: Mapping[str, Any], particles: HostParticles, motions: Sequence[Sequence[Motion]]) -> None:
        """Continue from a checkpoint.

        saved:      as `engine.checkpoint.saved_state`, without the particles and the clocks
        particles:  in the order of their ids
        motions:    motions of each wall
        """
        self._restore_lists(saved, particles, motions)
        self.state.clock.load_state_dict(saved["clock"])
        self.set_walls(saved["walls_present"], motions)
        load_sums(self.state, saved["energy_budget"])
        load_wall_dynamics(self.state, saved["wall_dynamics"])
        self.accounting.load_state_dict(saved["accounting"])
        self.steps_since_update = saved["steps_since_update"]
        self._started, self._walls_changed = True, False

    def _restore_lists(
        self, saved: Mapping[str, Any], particles: HostParticles, motions: Sequence[Sequence[Motion]]
    ) -> None:
        """Put the particles on the device; with the neighbor lists of their last rebuild, if it is known."""
        if saved["clock_at_rebuild"] is None:
            self.stepper.put(particles)
            return
        dynamics = dict(saved["wall_dynamics"])
        if "offset" in dynamics:
            dynamics["offset"] = dynamics["offset_at_rebuild"]
        load_wall_dynamics(self.state, dynamics)
        self.state.clock.load_state_dict(saved["clock_at_rebuild"])
        self.set_walls(saved["walls_present"], motions)
        self.stepper.restore(particles)
        self.stepper.steps_since_rebuild = saved["clock"]["step_count"] - self.state.clock.step_count

    def take_over(self, earlier: "Engine") -> None:
        """Continue the run of an earlier engine whose checkpoint has been restored here, with its pending changes."""
        self._started, self._walls_changed = earlier._started, earlier._walls_changed
        self.energy_before_change, self._counts_contacts = earlier.energy_before_change, earlier._counts_contacts
        self.timing.compile += earlier.timing.compile
        self.timing.growth_count += earlier.timing.growth_count
        self.stability_monitor.warnings |= earlier.stability_monitor.warnings

    def mean_kinetic_energy(self) -> float:
        """Mean translational and rotational kinetic energy [J] per particle that is not fixed."""
        arrays = self.synchronized(MOTION)
        kinetic, rotational, _ = mechanical_energy(arrays, self._gravity)
        return (kinetic + rotational) / max(mobility_mask(arrays).sum(), 1.0)

    def snapshot(self, stage: str, quantities: frozenset[str]) -> Snapshot:
        """Snapshot of the present state, read-only arrays in SI units; the run continues as without it.

        stage:       name of the present stage
        quantities:  subset of particles, contacts, walls and totals, as for observers

        With walls alone, `totals` contains the particle count only, and no contact statistics are computed.
        """
        return self._snapshot(stage, quantities, observed=False)

    def observe(self, stage: str, quantities: frozenset[str]) -> Snapshot:
        """As `snapshot`, for observers of a run: also checks the stability and updates the largest energy input."""
        return self._snapshot(stage, quantities, observed=True)

    def _snapshot(self, stage: str, quantities: frozenset[str], observed: bool) -> Snapshot:
        poses = wall_poses(self.state) if "walls" in quantities else {}
        if quantities <= {"walls"}:
            count = {"particle_count": float(self.particle_count)}
            return Snapshot(self.time, self.step_count, stage, {}, None, poses, count)
        pose = self.stepper.place_walls(self.step_count)
        measured = self.state.built(ContactStatistics).measure(pose)
        arrays, sums = self._particles_and_sums("particles" in quantities)
        totals = totals_of(self.state, self.accounting, sums, measured)
        if observed:
            self.stability_monitor.check(self.time, sums.energies, self.accounting, totals, sums.speed)
        particles = ordered_particles(arrays, self.accounting) if "particles" in quantities else {}
        contacts = self.state.built(ContactOutput).take(self.stepper.ids(), pose) if "contacts" in quantities else None
        impulses = wall_impulses(self.state)
        return Snapshot(self.time, self.step_count, stage, particles, contacts, poses, totals, impulses)

    def _particles_and_sums(self, needs_arrays: bool) -> tuple[dict[str, np.ndarray], ParticleSums]:
        """Arrays of a snapshot in device order, and sums over the particles; a GPU adds them up without arrays."""
        if not (needs_arrays or self.state.backend.on_cpu):
            return {}, device_sums(self.state, 0.5 * self.time_step * self._started)
        names = (each.name for each in PARTICLE_QUANTITIES.values() if each.in_snapshot and each.dtype)
        arrays = self.synchronized(tuple(names))
        sums = host_sums(arrays, self._gravity)
        arrays["position"], arrays["velocity"] = self.plan.periodic_box.wrap_with_velocity(
            arrays["position"], arrays["velocity"], self.time
        )
        return arrays, sums

    def free(self) -> None:
        """Give the device memory to later simulations of this process; this engine cannot continue."""
        if self._return_state.alive:
            freed: Any = FreedState(self.state)
            self.state = self.stepper.state = freed
            self._return_state()

    def _on_deleted(self, first: int, last: int) -> None:
        """Add the deleted particles to the accounting: indices `first` to `last`, exclusive, in device order.

        With `on_exit: error`, sets the abort code if one of them left the domain.
        """
        arrays = copy_to_host(self.state, DELETED_FIELDS, first, last)
        by_id = np.argsort(arrays["id"])
        arrays = {name: values[by_id] for name, values in arrays.items()}
        self._account_deleted({name: values[arrays["radius"] > REMOVED_BELOW] for name, values in arrays.items()})

    def _account_deleted(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Add deleted particles with the fields DELETED_FIELDS to the accounting; abort as `_on_deleted` states."""
        outlet_index = self._outlets_of(arrays["position"].astype(float))
        left_domain = outlet_index < 0
        if self.plan.domain.on_exit == "error" and left_domain.any():
            self.state.control.abort[0] = ABORT_LEFT_DOMAIN
            self.state.control.abort_particle[0] = int(arrays["id"][left_domain].min())
        self.accounting.delete(arrays, outlet_index, self._gravity)

    def _outlets_of(self, position: np.ndarray) -> np.ndarray:
        """Index of the outlet (n,) that deletes each particle at a position (n, 3) [m], -1 for none."""
        checked_axes = [axis for axis in range(3) if self.plan.domain.on_exit != "expand"]
        low, high = self.plan.domain_low[checked_axes], self.plan.domain_high[checked_axes]
        in_domain = np.all((position[:, checked_axes] >= low) & (position[:, checked_axes] <= high), axis=1)
        return outlet_of(self.plan.outlets, position, in_domain)

    def copied(self, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Fields on the host in device order, as they are on the device."""
        return self.state.ranks.gathered(copy_to_host(self.state, names))

    def synchronized(self, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Fields on the host in device order, with velocities and angular velocities at the time of the positions.

        names:    particle fields, with mass, velocity, force and, with rotation, radius, angular_velocity, torque
        Returns:  arrays (n,) or (n, 3); fields that the scene does not have are absent

            v(t) = v(t - dt/2) + dt F(t) / (2 m),   w(t) = w(t - dt/2) + dt M(t) / (2 I),   I = (2/5) m R^2

        Before the first step they are the initial values: a run that aborts there has not shifted them.
        """
        arrays = self.copied(tuple(dict.fromkeys((*names, "fixed"))))
        if not self._started:
            return arrays
        half = 0.5 * self.time_step * mobility_mask(arrays)[:, None]
        mass = arrays["mass"].astype(float)[:, None]
        arrays["velocity"] = arrays["velocity"] + half * arrays["force"] / mass
        if "angular_velocity" in arrays:
            inertia = 0.4 * mass * arrays["radius"].astype(float)[:, None] ** 2
            arrays["angular_velocity"] = arrays["angular_velocity"] + half * arrays["torque"] / inertia
        return arrays
