"""Device interface of the simulation: insert particles, set walls, advance, take a snapshot."""

import weakref
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from granflow.engine.accounting import Accounting, mechanical_energy
from granflow.engine.backend import Backend
from granflow.engine.changes import write_particles
from granflow.engine.deleted_particles import account_deleted, deleted_particles
from granflow.engine.force.damping import write_damping
from granflow.engine.force.max_impact_velocity import MaxImpactVelocity
from granflow.engine.frozen_masks import mobility_mask
from granflow.engine.gpu_stepper import GpuStepper
from granflow.engine.host_copy import append_particles
from granflow.engine.host_particles import HostParticles
from granflow.engine.insertion import new_particle_arrays, sphere_rows
from granflow.engine.integrate import build_kick
from granflow.engine.limits import NO_PARTICLE, Change
from granflow.engine.readings import MOTION, Readings
from granflow.engine.saved_particles import RankFiles
from granflow.engine.saved_sums import load_sums, load_wall_dynamics, saved_sums, saved_wall_dynamics
from granflow.engine.stability_monitor import StabilityMonitor
from granflow.engine.state import FreedState, State
from granflow.engine.state_cache import return_state, take_state
from granflow.engine.stepper import Stepper
from granflow.errors import GranflowError
from granflow.geometry.motion import Motion, pose
from granflow.particles.particle_data import ParticleData
from granflow.plan.adaptive_time_step import STEPS_BETWEEN_UPDATES
from granflow.plan.plan import Plan

_T = TypeVar("_T")


class Engine(Readings):
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
        self._stage, self._walls_appeared = plan.stages[0].name, list[str]()
        self._stopping_change: Change | None = None
        self._started = False
        self.energy_before_change: float | None = None
        self._counts_contacts = False
        self.kept_particles: HostParticles | None = None

    def _new_stepper(self) -> Stepper:
        """The stepper of the state."""
        kind = Stepper if self.state.backend.on_cpu else GpuStepper
        return kind(self.state, self._on_deleted)

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
        rows = sphere_rows(self.plan, new)
        self.accounting.insert(new.material[rows], new.group[rows], self.time, energy)
        if self.energy_before_change is not None:
            self.energy_before_change += energy
        if self._started:
            velocity_gain = mobility_mask(arrays)[:, None] * (0.5 * self.time_step * self._gravity)
            for name in ("velocity", "clump_velocity"):
                if name in arrays:
                    arrays[name] = arrays[name] - velocity_gain
        self._append(arrays | {"velocity_synchronized": arrays["velocity"]})

    def _append(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Append particles on the device, see `append_particles`."""
        append_particles(self.state, arrays)

    def restart(self, new: ParticleData, time_step: float | None = None) -> None:
        """Replace all particles, with initial forces and without contact history; also after an abort.

        new:        particles at the present time
        time_step:  of all further steps [s]; None: the present one
        Raises:     GranflowError for a scene with clumps
        """
        self._refuse_with_clumps("Particles from Python")
        state = self.state
        state.count = 0
        state.control.abort[0], state.control.abort_particle[0] = 0, NO_PARTICLE
        for row in (state.neighbors.list_begin, state.neighbors.list_end):
            row.fill(0)
        if time_step is not None:
            state.clock.change(time_step)
        self.accounting = Accounting(outlets={outlet.name: [0.0, 0.0] for outlet in self.plan.outlets})
        self._started, self.energy_before_change, self._stopping_change = False, None, None
        self.insert(new)
        self.refresh()

    def set_walls(self, present: Sequence[bool], motions: Sequence[Sequence[Motion]]) -> None:
        """Set which walls are present and their motions; takes effect with the next `refresh`.

        present:  one entry per wall of the plan
        motions:  motions of each wall
        """
        self.state.wall_motions = tuple(tuple(each) for each in motions)
        for index, is_present in enumerate(present):
            if is_present and not self.state.walls.present[index]:
                self._walls_appeared.append(self.plan.walls[index].name)
            self.state.walls.present[index] = int(is_present)
            pivot = pose(self.state.wall_motions[index], np.array([self.time])).pivot
            self.state.walls.pivot[index] = pivot.tolist()
        self._walls_changed = True

    def set_stage(self, stage: str) -> None:
        """Set the stage, which may have damping; takes effect with the next forces."""
        self._stage = stage
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
        self.stepper.poses.discard()
        self.stepper.refresh(self.step_count, velocities_lag=self._started)
        if self._started and self.aborted:
            self._stopping_change = Change(self._stage, tuple(self._walls_appeared))
        else:
            self._stopping_change = None
        self._walls_appeared.clear()
        if before is not None:
            self.accounting.inserted_energy += energy() - before
        self._walls_changed, self.energy_before_change = False, None
        if not self._started and not self.aborted:
            self._started = True
            self._kick(-0.5 * self.time_step)
        self._update_time_step()

    def _refuse_with_clumps(self, what: str) -> None:
        """Raise GranflowError for a scene with clumps; `what`: subject of the message, in the plural."""
        if self.plan.features.clumps:
            raise GranflowError(f"{what} are not possible in a scene with clumps.")

    def _kick(self, time: float) -> None:
        """Change the velocities by the present forces during `time` [s]; backwards if negative."""
        self.state.built(build_kick)(self.state.count, time)

    def begin_change(self) -> None:
        """Prepare a change of the particles: shift all velocities to the time of the positions.

        The next `refresh` shifts them back, and counts the change of all energies as inserted. Raises GranflowError for
        a scene with clumps.
        """
        self._refuse_with_clumps("Changes of particles and forces from Python")
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
        self.stepper.poses.discard()
        self.stepper.poses.index_at(self.step_count)
        step = adaptive_time_step.step_for(
            self.state.built(MaxImpactVelocity).measure(), float(np.linalg.norm(self._gravity)) * self.time_step
        )
        if step != self.time_step:
            self._kick(0.5 * (self.time_step - step))
            self.state.clock.change(step)
            self.stepper.poses.discard()

    def saved_particles(self) -> HostParticles:
        """The particles of this process with their contact histories, for a checkpoint."""
        return self.stepper.saved_particles()

    def saved_sums(self) -> dict[str, Any]:
        """Sums and force-controlled walls, for a checkpoint."""
        return {"energy_budget": saved_sums(self.state), "wall_dynamics": saved_wall_dynamics(self.state)}

    def on_each_rank(self, task: "Callable[[Engine, int], _T]") -> list[_T]:
        """Results of task(engine, rank) on all MPI ranks; one without MPI. Raises OSError of any task."""
        return [task(self, 0)]

    def restore(
        self,
        saved: Mapping[str, Any],
        particles: HostParticles,
        motions: Sequence[Sequence[Motion]],
        files: RankFiles | None = None,
    ) -> None:
        """Continue from a checkpoint.

        saved:      as `engine.checkpoint.saved_state`, without the particles and the clocks
        particles:  in the order of their ids
        motions:    motions of each wall
        files:      None: only MPI ranks read files with further particles
        """
        self._restore_lists(saved, particles, motions)
        self.state.clock.load_state_dict(saved["clock"])
        self.set_walls(saved["walls_present"], motions)
        load_sums(self.state, saved["energy_budget"])
        load_wall_dynamics(self.state, saved["wall_dynamics"])
        self.accounting.load_state_dict(saved["accounting"])
        self.steps_since_update = saved["steps_since_update"]
        self._started, self._walls_changed = True, False
        self._walls_appeared.clear()

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
        self._walls_appeared = list(earlier._walls_appeared)
        self.energy_before_change, self._counts_contacts = earlier.energy_before_change, earlier._counts_contacts
        self.timing.compile += earlier.timing.compile
        self.timing.growth_count += earlier.timing.growth_count
        self.stability_monitor.warnings |= earlier.stability_monitor.warnings

    def free(self) -> None:
        """Give the device memory to later simulations of this process; this engine cannot continue."""
        if self._return_state.alive:
            freed: Any = FreedState(self.state)
            self.state = self.stepper.state = freed
            self._return_state()

    def _on_deleted(self, first: int, last: int) -> None:
        """Add the deleted particles to the accounting: indices `first` to `last`, exclusive, in device order."""
        self._account_deleted(deleted_particles(self.state, first, last))

    def _account_deleted(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Add deleted particles with the fields DELETED_FIELDS to the accounting; may abort, see `account_deleted`."""
        account_deleted(self.state, self.accounting, arrays)
