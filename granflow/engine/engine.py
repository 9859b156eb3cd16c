"""The engine: the device interface of a simulation.

`Engine` connects a plan with the device. It owns a `State` (arrays and clock), a `Stepper` (kernels) and the
accounting of inserted and deleted particles. Its methods insert particles, set walls, take steps, and return
snapshots, sums and the state for a checkpoint. It knows neither stages nor observers nor files:
`granflow.runs` decides what happens when.
"""

import weakref
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Any, TypeVar

import numpy as np

from granflow.contact.particle_equation import CONTENT_CHANGES
from granflow.engine.abort import Diagnosis, WallChange, diagnose
from granflow.engine.attached import attached_velocities
from granflow.engine.backend import Backend
from granflow.engine.clumps import CLUMP_MOTION, forces_with_weight, synchronized_clumps
from granflow.engine.contact import collision_counts
from granflow.engine.deformation import at_rebuild, write_deformation
from granflow.engine.deletions import mark_deletions
from granflow.engine.fields import write_field
from granflow.engine.gravity import present_gravity
from granflow.engine.host import (
    Histories,
    HostParticles,
    append_particles,
    copy_to_host,
    new_particle_arrays,
    sphere_rows,
    write_particles,
)
from granflow.engine.particle_forces import write_damping
from granflow.engine.settings import apply_settings
from granflow.engine.state import FreedState, State, mobility_mask
from granflow.engine.state_cache import return_state, take_state
from granflow.engine.statistics import ContactOutput, ContactStatistics, MaxImpactVelocity
from granflow.engine.step import build_kick
from granflow.engine.stepper import GpuStepper, Stepper
from granflow.engine.sums import canonical, chunk_words, exact_sum
from granflow.engine.totals import (
    Accounting,
    ParticleSums,
    StabilityMonitor,
    account_deleted,
    content_fields,
    contents_of,
    deleted_particles,
    device_sums,
    ended_contacts_dissipation,
    host_sums,
    mechanical_energy,
    ordered_particles,
    totals_of,
    wall_poses,
)
from granflow.engine.wall_dynamics import shift_bodies, wall_impulses
from granflow.engine.walls import torque_points
from granflow.engine.wear import wall_wear, wear_totals
from granflow.errors import GranflowError
from granflow.fields import PARTICLE_QUANTITIES
from granflow.geometry.sphere import sphere_inertia
from granflow.io.checkpoint import RankFile
from granflow.particles.group import ParticleData
from granflow.plan.arrays import (
    DeviceArray,
    deformation_arrays,
    particle_arrays,
    saved_arrays,
    sum_arrays,
    wall_dynamics_arrays,
)
from granflow.plan.plan import Plan
from granflow.plan.time_step import STEPS_BETWEEN_UPDATES
from granflow.scene.blocks.gravity import GravityCourse
from granflow.scene.blocks.motions import TimedMotion, poses_at
from granflow.snapshot import Snapshot

_T = TypeVar("_T")
TIME_TOLERANCE = 1e-6
"""Tolerance for reaching a requested time, as a fraction of the time step."""
MOTION = ("mass", "radius", "position", "velocity", "angular_velocity", "force", "torque", *CLUMP_MOTION)
"""Fields that determine the mechanical energy at the time of the positions."""
SHIFTED = ("velocity", "angular_velocity", "clump_velocity", "clump_angular_momentum")
"""Fields that are half a step behind the positions."""
CONTACT_COUNTS = ("coordination_number", "wall_contact_count")
"""Fields with the number of contacts of each particle."""


@dataclass(frozen=True)
class RestState:
    """How close the mobile particles are to rest.

    kinetic_energy:  mean translational and rotational kinetic energy [J] per particle
    unbalanced:      magnitude of the net force on all of them over their weight, which is the acceleration of
                     the center of mass over gravity: 1 in free fall, 0 in equilibrium; 0 without gravity
    """

    kinetic_energy: float
    unbalanced: float


class Engine:
    """One plan on one backend; the clock of the state counts steps and time.

    Typical order: `insert`, `set_walls` and `refresh`, then `advance` and `observe` repeatedly; again
    `refresh` after particles or walls have changed; `free` at the end. Snapshots, energies and sums change
    nothing, except for the records of `observe`.

    `accounting`: inserted and deleted particles and their energies; `timing`: wall-clock time by phase;
    `stability_monitor`: checks at each observation; `energy_before_change`: mechanical energy [J] before a
    change of particles from Python, None without one; `kept_particles`: copy for a later checkpoint.
    """

    def __init__(self, plan: Plan, backend: Backend) -> None:
        self.plan = plan
        self.state: State = take_state(plan, backend)
        self._return_state = weakref.finalize(self, return_state, self.state)
        self._return_state.atexit = False
        self.stepper = self._new_stepper()
        self.timing = self.stepper.timing
        self.accounting = self._new_accounting()
        self.stability_monitor = StabilityMonitor(plan)
        self.steps_since_update = 0
        self._gravity = np.array(plan.scene.gravity_at_start)
        self._walls_changed = False
        self._stage = plan.stages[0].name
        self._walls_appeared = list[str]()
        self._stopping_change: WallChange | None = None
        self._velocities_lag = False
        self._first_unshifted_id: int | None = None
        self.energy_before_change: float | None = None
        self._counts_contacts = False
        self._deletes = False
        self.kept_particles: HostParticles | None = None

    def _new_stepper(self) -> Stepper:
        """The stepper of the state."""
        kind = Stepper if self.state.backend.on_cpu else GpuStepper
        return kind(self.state, self._on_deleted)

    def _new_accounting(self) -> Accounting:
        """The accounting before any particle is inserted."""
        scene = self.plan.scene
        return Accounting(
            outlets={name: [0.0, 0.0] for name in scene.outlets},
            contents={
                each.content_change(change).name: 0.0
                for each in scene.equations
                for change in (CONTENT_CHANGES if each.content is not None else ())
            },
        )

    # Time and status.

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
        """True if particles or walls have changed since the last `refresh`; see `begin_change`."""
        return self._walls_changed or self.energy_before_change is not None

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
        return diagnose(code, particle, self.state, self.time, self._velocities_lag, self._stopping_change)

    # Particles and walls.

    def insert(self, new: ParticleData) -> None:
        """Insert particles at the present time; the next `refresh` computes their forces.

        new:  k particles; material numbers of the scene, velocities [m/s] at the present time

        Ids continue the count of inserted particles. After the start, velocities are shifted half a step back
        by gravity, as the leapfrog scheme requires; if more acts on a free particle, by all forces after
        `refresh`. The mechanical energy counts as inserted.
        """
        if not len(new):
            return
        first_id = self.accounting.inserted_count
        arrays = new_particle_arrays(self.plan, new, first_id)
        energy = sum(mechanical_energy(arrays, self._gravity))
        rows = sphere_rows(self.plan, new)
        self.accounting.insert(new.material[rows], new.group[rows], self.time, energy)
        self.accounting.change_contents(self.plan, "inserted", arrays)
        if self.energy_before_change is not None:
            self.energy_before_change += energy
        features = self.plan.features
        if self._velocities_lag and (features.external_forces or features.damping != "none"):
            if self._first_unshifted_id is None:
                self._first_unshifted_id = first_id
        elif self._velocities_lag:
            velocity_gain = mobility_mask(arrays)[:, None] * (
                0.5 * self.time_step * present_gravity(self.state)
            )
            for name in ("velocity", "clump_velocity"):
                if name in arrays:
                    arrays[name] = arrays[name] - velocity_gain
        synchronized = {
            f"{name}_synchronized": arrays[name]
            for name in ("velocity", "angular_velocity")
            if name in arrays
        }
        self._append(arrays | synchronized)

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
        state.control.clear_abort()
        for row in (state.neighbors.list_begin, state.neighbors.list_end):
            row.fill(0)
        if time_step is not None:
            state.clock.change(time_step)
        self.accounting = self._new_accounting()
        self._velocities_lag = False
        self._first_unshifted_id = None
        self.energy_before_change = None
        self._stopping_change = None
        self.insert(new)
        self.refresh()

    def set_walls(self, present: Sequence[bool], motions: Sequence[Sequence[TimedMotion]]) -> None:
        """Set which walls are present and their motions; takes effect with the next `refresh`.

        present:  one entry per wall of the plan
        motions:  motions of each wall
        """
        self.state.wall_motions = tuple(tuple(each) for each in motions)
        for index, is_present in enumerate(present):
            if is_present and not self.state.walls.present[index]:
                self._walls_appeared.append(self.plan.walls[index].name)
            self.state.walls.present[index] = int(is_present)
            pivot = poses_at(self.state.wall_motions[index], np.array([self.time])).pivot
            self.state.walls.pivot[index] = pivot.tolist()
        if self.plan.features.wall_forces and not self.plan.features.moving_walls:
            self.state.walls.torque_point.from_numpy(torque_points(self.state, np.zeros(1)))
        self._walls_changed = True

    def set_stage(self, stage: str) -> None:
        """Set the stage, which may have damping and a deformation of the periodic box."""
        self._stage = stage
        write_deformation(self.state, stage)
        write_damping(self.state, stage)

    def begin_stage(self, stage: str, course: GravityCourse) -> None:
        """As `set_stage` and `set_gravity`, from the present time on.

        Velocities are half a step behind: if gravity or the damping jumps, they are shifted to the present
        time by the forces before the jump, and `refresh` shifts them back by those after it.
        """
        state = self.state
        now = np.array([self.time])
        jump = course.at(now)[0] - state.gravity_course.at(now)[0]
        damping = self.plan.scene.damping
        other_damping = damping is not None and damping.values(stage) != damping.values(self._stage)
        if self._velocities_lag and (other_damping or jump.any()):
            self._kick(0.5 * self.time_step)
            self._velocities_lag = False
            shift_bodies(state, jump)
        self.set_stage(stage)
        self.set_gravity(course)

    def set_gravity(self, course: GravityCourse) -> None:
        """Set how gravity acts; takes effect with the next `refresh`."""
        self.state.gravity_course = course
        self.stepper.poses.discard()

    def apply_settings(self, stage: str) -> list[int]:
        """Set the properties that particles take at the start of a stage; returns the number of particles to
        which each setting applies.

        The next `refresh` computes what flows then.
        """
        settings = next(each.set_ for each in self.plan.stages if each.name == stage)
        return apply_settings(self.state, self.accounting, settings)

    def delete(self, stage: str) -> list[int]:
        """Delete the particles that vanish at the start of a stage, before its walls are set; returns the
        number of particles of each deletion.

        The energy of their contacts counts as removed. As `refresh`, it computes the forces.
        """
        counts_contacts = self.plan.features.energy_budget
        before = self._contact_energy() if counts_contacts else 0.0
        counts = mark_deletions(self.state, self.accounting, stage)
        self._deletes = True
        self.refresh()
        self._deletes = False
        if counts_contacts:
            self.accounting.inserted_energy += self._contact_energy() - before
        return counts

    def begin_change(self) -> None:
        """Prepare a change of the particles: shift all velocities to the time of the positions.

        The next `refresh` shifts them back, and counts the change of all energies as inserted.
        """
        if self.energy_before_change is not None:
            return
        self._counts_contacts = self.timing.rebuild_count > 0
        arrays = self.synchronized(MOTION)
        self.energy_before_change = self._stored_energy(arrays)
        if self._velocities_lag:
            motion = {name: values for name, values in arrays.items() if name in SHIFTED}
            write_particles(self.state, np.arange(self.state.count), motion)
            self._velocities_lag = False

    def refresh(self) -> None:
        """Rebuild the neighbor list and compute the forces after particles or walls were added or removed.

        The first call also shifts velocities half a step back, as the leapfrog scheme requires. If a wall
        appears between particles, or disappears, the energy of its contacts counts as inserted or removed;
        after a change of the particles, the change of all energies, without that of the particles which the
        rebuild deletes.
        """
        before = self.energy_before_change
        removed_before = self.accounting.removed_energy
        stored_energy = self.stored_energy
        if before is None and self.plan.features.energy_budget and self._walls_changed:
            before = self._contact_energy()
            stored_energy = self._contact_energy
        self.stepper.poses.discard()
        self.stepper.refresh(self.step_count, velocities_lag=self._velocities_lag)
        self.state.clock.time_step_of_forces = self.plan.longest_time_step
        if self._velocities_lag and self.aborted:
            self._stopping_change = WallChange(self._stage, tuple(self._walls_appeared))
        else:
            self._stopping_change = None
        self._walls_appeared.clear()
        if before is not None:
            if self.energy_before_change is not None:
                before -= self.accounting.removed_energy - removed_before
            self.accounting.inserted_energy += stored_energy() - before
        self._walls_changed = False
        self.energy_before_change = None
        if not self._velocities_lag and not self.aborted:
            self._velocities_lag = True
            self._kick(-0.5 * self.time_step)
        elif self._first_unshifted_id is not None and not self.aborted:
            self._kick(-0.5 * self.time_step, self._first_unshifted_id)
        self._first_unshifted_id = None
        self._update_time_step()

    # Time steps.

    def advance(self, steps: int) -> None:
        """Take `steps` steps; fewer after an abort and, with an adaptive time step, after a rebuild.

        `step_count`, `time` and `aborted` show the result. An adaptive time step is updated after a rebuild,
        and after STEPS_BETWEEN_UPDATES steps, which `steps` must not exceed then.
        """
        rebuilds = self.timing.rebuild_count
        done = self.stepper.advance(steps, self.step_count)
        self.state.clock.step_count += done
        if done:
            self.state.clock.time_step_of_forces = self.state.clock.time_step
        if self.plan.adaptive_time_step is None:
            return
        self.steps_since_update += done
        if self.steps_since_update >= STEPS_BETWEEN_UPDATES or self.timing.rebuild_count > rebuilds:
            self._update_time_step()

    @property
    def overlap_limit(self) -> float:
        """Overlap over the smaller radius above which `advance` ends with a diagnosis."""
        return float(self.state.control.overlap_limit[0])

    def permit_overlap(self, limit: float) -> None:
        """Go on after a step that has ended with an overlap above the limit, with a higher limit."""
        self.stepper.permit_overlap(limit)
        if self.steps_since_update == 0:  # an abort leaves an adaptive time step as it is
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
            self.state.built(MaxImpactVelocity).measure(),
            self.plan.scene.largest_gravity * self.time_step,
        )
        if step != self.time_step:
            self._kick(0.5 * (self.time_step - step))
            self.state.clock.change(step)
            self.stepper.poses.discard()

    def _kick(self, time: float, first_id: int = 0) -> None:
        """Change the velocities of particles with ids from `first_id` on by the present forces during `time`
        [s]; backwards if negative."""
        pose = self.stepper.poses.index_at(self.step_count)
        self.state.built(build_kick)(self.state.count, time, pose, first_id)

    # Energies and snapshots.

    def _contact_energy(self) -> float:
        """Elastic energy and plastic dissipation [J] of the present contacts."""
        measured = self.state.built(ContactStatistics).measure(self.stepper.poses.index_at(self.step_count))
        return measured["elastic_energy"] + measured["plastic_dissipation"]

    def stored_energy(self) -> float:
        """Mechanical energy [J] of the particles, and of contacts that existed before a change.

        The latter are the elastic energy and the plastic dissipation of present contacts, and with the energy
        budget that of ended ones.
        """
        return self._stored_energy(self.synchronized(MOTION))

    def _stored_energy(self, arrays: Mapping[str, np.ndarray]) -> float:
        """`stored_energy` with the fields MOTION at the time of the positions."""
        energy = sum(mechanical_energy(arrays, self._gravity))
        if self._counts_contacts:
            energy += self._contact_energy() + ended_contacts_dissipation(self.state)
        return energy

    def rest_state(self) -> RestState:
        """Mean kinetic energy and net force of the particles that are not fixed.

        They do not depend on the order of the particles.
        """
        arrays = self._own_synchronized(MOTION)
        ranks = self.state.ranks
        kinetic, rotational, _ = mechanical_energy(arrays, self._gravity, ranks)
        mobile = mobility_mask(arrays)
        mobile_count = float(ranks.total(np.array([mobile.sum()]))[0])
        gravity = present_gravity(self.state)
        weight = exact_sum(arrays["mass"].astype(float) * mobile, ranks) * float(np.linalg.norm(gravity))
        force = forces_with_weight(arrays, gravity)
        net = [exact_sum(component * mobile, ranks) for component in force.T]
        unbalanced = float(np.linalg.norm(net)) / weight if weight else 0.0
        return RestState((kinetic + rotational) / max(mobile_count, 1.0), unbalanced)

    def snapshot(self, stage: str, quantities: frozenset[str]) -> Snapshot:
        """Snapshot of the present state, read-only arrays in SI units; the run continues as without it.

        stage:       name of the present stage
        quantities:  subset of particles, contacts, walls and totals, as for observers

        With walls alone, `totals` contains the particle count only, and no contact statistics are computed.
        """
        return self._snapshot(stage, quantities, observed=False)

    def observe(self, stage: str, quantities: frozenset[str]) -> Snapshot:
        """As `snapshot`, for observers of a run.

        It also checks the stability and updates the largest energy input.
        """
        return self._snapshot(stage, quantities, observed=True)

    def _snapshot(self, stage: str, quantities: frozenset[str], observed: bool) -> Snapshot:
        poses = wall_poses(self.state) if "walls" in quantities else {}
        if quantities <= {"walls"}:
            count = {"particle_count": float(self.particle_count)}
            wear = wall_wear(self.state)
            return Snapshot(self.time, self.step_count, stage, {}, None, poses, count, wear=wear)
        pose = self.stepper.poses.index_at(self.step_count)
        measured = self.state.built(ContactStatistics).measure(pose)
        arrays, sums = self._particles_and_sums("particles" in quantities)
        totals = totals_of(self.state, self.accounting, sums, measured)
        if observed:
            self.stability_monitor.check(self.time, sums.energies, self.accounting, totals, sums.speed)
        particles = ordered_particles(arrays, self.accounting) if "particles" in quantities else {}
        contacts = (
            self.state.built(ContactOutput).take(self.stepper.ids(), pose)
            if "contacts" in quantities
            else None
        )
        wear = wall_wear(self.state)
        totals |= wear_totals(self.state, wear)
        since_start = wall_impulses(self.state), collision_counts(self.state), wear, self.accounting.removed
        return Snapshot(self.time, self.step_count, stage, particles, contacts, poses, totals, *since_start)

    def _particles_and_sums(self, needs_arrays: bool) -> tuple[dict[str, np.ndarray], ParticleSums]:
        """Arrays of a snapshot in device order if needed, and sums over the particles.

        A GPU adds them up by itself.
        """
        equations = content_fields(self.plan)
        if not (needs_arrays or self.state.backend.on_cpu or self.plan.features.clumps or equations):
            return {}, device_sums(self.state, 0.5 * self.time_step * self._velocities_lag)
        shown = self._shown if needs_arrays else (*MOTION, *CONTACT_COUNTS)
        own = self._own_synchronized((*shown, *equations))
        sums = host_sums(own, self._gravity, self.state.ranks)
        if equations:
            sums = replace(sums, contents=contents_of(self.plan, own, self.state.ranks))
            for name in ("loss_heat", "loss_heat_ahead"):
                own.pop(name, None)
        return self._in_box(self.state.ranks.gathered(own)) if needs_arrays else {}, sums

    def own_particles(self) -> dict[str, np.ndarray]:
        """As `Snapshot.particles`, of this process only; all MPI ranks call this together."""
        self.state.built(ContactStatistics).measure(
            self.stepper.poses.index_at(self.step_count)
        )  # contacts per particle
        return ordered_particles(self._in_box(self._own_synchronized(self._shown)), self.accounting)

    @property
    def _shown(self) -> tuple[str, ...]:
        """Fields of snapshots."""
        return tuple(each.name for each in PARTICLE_QUANTITIES.values() if each.in_snapshot and each.dtype)

    def _in_box(self, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The arrays with positions in the periodic box, and the velocities there."""
        position, velocity = self.state.periodic_box.wrap_with_velocity(
            arrays["position"], arrays["velocity"], self.time
        )
        return arrays | {"position": position, "velocity": velocity}

    def copied(self, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Fields on the host in device order, as they are on the device."""
        return self.state.ranks.gathered(copy_to_host(self.state, names))

    def synchronized(self, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Fields on the host in device order, with velocities at the time of the positions.

        names:    particle fields
        Returns:  arrays (n,) or (n, 3) by name, also of the fields that determine the velocities; fields that
                  the scene does not have are absent

            v(t) = v(t - dt/2) + dt F(t) / (2 m),   w(t) = w(t - dt/2) + dt M(t) / (2 I),   I = (2/5) m R^2

        Before the first step they are the initial values: a run that aborts there has not shifted them.
        """
        return self.state.ranks.gathered(self._own_synchronized(names))

    def _own_synchronized(self, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """As `synchronized`, of the particles of this process."""
        has_clumps = self.plan.features.clumps
        rotation = (
            ("radius", "angular_velocity", "torque") if has_clumps or "angular_velocity" in names else ()
        )
        clump_motion = CLUMP_MOTION if has_clumps else ()
        attachment = ("attached_to", "position") if self.plan.features.attached_particles else ()
        needed = ("mass", "velocity", "force", "fixed", *rotation, *clump_motion, *attachment)
        arrays = copy_to_host(self.state, tuple(dict.fromkeys((*names, *needed))))
        if not self._velocities_lag:
            return arrays
        arrays |= attached_velocities(self.state, arrays)
        clumps = synchronized_clumps(arrays, 0.5 * self.time_step, present_gravity(self.state))
        half = 0.5 * self.time_step * mobility_mask(arrays)[:, None]
        mass = arrays["mass"].astype(float)[:, None]
        arrays["velocity"] = arrays["velocity"] + half * arrays["force"] / mass
        if "angular_velocity" in arrays:
            inertia = sphere_inertia(mass, arrays["radius"].astype(float)[:, None])
            arrays["angular_velocity"] = arrays["angular_velocity"] + half * arrays["torque"] / inertia
        if clumps:
            in_clump = ((arrays["clump"] >= 0) & (mobility_mask(arrays) > 0.0))[:, None]
            arrays |= {name: np.where(in_clump, values, arrays[name]) for name, values in clumps.items()}
        return arrays

    # Checkpoints, and the end.

    def saved_particles(self) -> HostParticles:
        """The particles of this process with their contact histories, for a checkpoint."""
        return self.stepper.saved_particles()

    def saved_sums(self) -> dict[str, Any]:
        """Sums, force-controlled walls and the deforming box, for a checkpoint."""
        return {
            "energy_budget": saved_sums(self.state),
            "wall_dynamics": saved_wall_dynamics(self.state),
            "deformation": saved_deformation(self.state),
        }

    def on_each_rank(self, task: "Callable[[Engine, int], _T]") -> list[_T]:
        """Results of task(engine, rank) on all MPI ranks; one without MPI. Raises OSError of any task."""
        return [task(self, 0)]

    def restore(
        self,
        saved: Mapping[str, Any],
        particles: HostParticles,
        motions: Sequence[Sequence[TimedMotion]],
        files: Sequence[RankFile] = (),
    ) -> None:
        """Continue from a checkpoint.

        saved:      as `engine.checkpoint.saved_state`, without the particles and the clocks
        particles:  in the order of their ids
        motions:    motions of each wall
        files:      with further particles; only MPI ranks read them
        """
        self._restore_lists(saved, particles, motions)
        self.state.clock.load_state_dict(saved["clock"])
        self.set_walls(saved["walls_present"], motions)
        load_sums(self.state, saved["energy_budget"])
        load_wall_dynamics(self.state, saved["wall_dynamics"])
        load_deformation(self.state, saved["deformation"])
        self.accounting.load_state_dict(saved["accounting"])
        self.steps_since_update = saved["steps_since_update"]
        if self.plan.scene.numerics.max_overlap == "auto":
            self.state.control.overlap_limit[0] = saved["overlap_limit"]
        self._velocities_lag = True
        self._walls_changed = False
        self._walls_appeared.clear()

    def _restore_lists(
        self, saved: Mapping[str, Any], particles: HostParticles, motions: Sequence[Sequence[TimedMotion]]
    ) -> None:
        """Put the particles on the device; with the neighbor lists of their last rebuild, if it is known."""
        if saved["clock_at_rebuild"] is None:
            self.stepper.put(particles)
            return
        dynamics = dict(saved["wall_dynamics"])
        if "offset" in dynamics:
            dynamics["offset"] = dynamics["offset_at_rebuild"]
        load_wall_dynamics(self.state, dynamics)
        load_deformation(self.state, at_rebuild(saved["deformation"]))
        self.state.clock.load_state_dict(saved["clock_at_rebuild"])
        self.set_walls(saved["walls_present"], motions)
        self.stepper.restore(particles)
        self.stepper.steps_since_rebuild = saved["clock"]["step_count"] - self.state.clock.step_count

    def take_over(self, earlier: "Engine") -> None:
        """Continue the run of an earlier engine, with its pending changes.

        Its checkpoint has been restored here.
        """
        self._velocities_lag = earlier._velocities_lag
        self._walls_changed = earlier._walls_changed
        self._walls_appeared = list(earlier._walls_appeared)
        self.energy_before_change = earlier.energy_before_change
        self._counts_contacts = earlier._counts_contacts
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
        """Add the deleted particles to the accounting: `first` to `last`, exclusive, in device order."""
        self._account_deleted(deleted_particles(self.state, first, last))

    def _account_deleted(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Add deleted particles with their `deleted_fields` to the accounting.

        This may abort the run, see `account_deleted`.
        """
        account_deleted(self.state, self.accounting, arrays, counts_removed=self._deletes)


# Sums over the chunks of particles, and force-controlled walls, in checkpoints.

OTHER_FEATURES = (
    "Friction, rolling friction, the energy budget, wall forces, wear and collision energies cannot be "
    "switched on or off in a resumed run."
)
"""End of messages on arrays that do not match those of the scene."""


def saved_sums(state: State) -> dict[str, np.ndarray]:
    """Terms of the energy budget and of the wall forces by name, summed over chunks and MPI ranks, int64."""
    fields = {name: getattr(state.control, name) for name in _sums(state.plan)}
    totals = {
        name: state.ranks.total(field.to_numpy() if len(field.shape) > 1 else chunk_words(state, field))
        for name, field in fields.items()
    }
    return {name: canonical(words.sum(axis=0)) for name, words in totals.items()}


def load_sums(state: State, saved: Mapping[str, np.ndarray]) -> None:
    """Restore the sums that `saved_sums` returned.

    On all ranks but the root there are none, and the sums are zero.

    Raises GranflowError if an array is missing or unknown.
    """
    arrays = _sums(state.plan)
    if saved:
        refuse_other_arrays(saved, {name: array.full_shape[1:] for name, array in arrays.items()})
    for name, array in arrays.items():
        _load(getattr(state.control, name), array, saved.get(name))


def saved_wall_dynamics(state: State) -> dict[str, Any]:
    """Keys of the force-controlled motions, and their arrays, forces summed over the chunks."""
    found: dict[str, Any] = {"controlled_motions": [each.key for each in state.plan.controlled_motions]}
    return found | _saved_fields(state.wall_dynamics, _dynamics(state.plan))


def load_wall_dynamics(state: State, saved: Mapping[str, Any]) -> None:
    """Restore what `saved_wall_dynamics` returned. Raises GranflowError if the scene has other motions."""
    before = saved["controlled_motions"]
    now = [controlled.key for controlled in state.plan.controlled_motions]
    if before != now:
        named = (", ".join(each) or "none" for each in (before, now))
        raise GranflowError(
            "The force-controlled wall motions are {} in the checkpoint and {} in the scene. A resumed run "
            "can change the parameters of such a motion but not add or remove one; use stages for "
            "that.".format(*named)
        )
    _load_fields(state.wall_dynamics, _dynamics(state.plan), saved)


def saved_deformation(state: State) -> dict[str, np.ndarray]:
    """Arrays of the deforming box, its sums over the chunks; empty with constant widths."""
    return _saved_fields(state.deformation, _deformation(state.plan))


def load_deformation(state: State, saved: Mapping[str, np.ndarray]) -> None:
    """Restore what `saved_deformation` returned."""
    _load_fields(state.deformation, _deformation(state.plan), saved)


def _saved_fields(owner: Any, arrays: Mapping[str, DeviceArray]) -> dict[str, np.ndarray]:
    """Values of the fields of `owner` with the names of the arrays; sums over the chunks."""
    values = {name: getattr(owner, name).to_numpy() for name in arrays}
    return {name: each.sum(axis=0) if arrays[name].by_chunk else each for name, each in values.items()}


def _load_fields(owner: Any, arrays: Mapping[str, DeviceArray], saved: Mapping[str, np.ndarray]) -> None:
    """Write what `_saved_fields` returned."""
    for name, array in arrays.items():
        _load(getattr(owner, name), array, saved[name])


def refuse_other_arrays(saved: Mapping[str, np.ndarray], shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise GranflowError if an array of a checkpoint is missing or unknown, or has other last axes.

    shapes: ends of the shapes of the arrays
    """
    if set(saved) != set(shapes):
        present, needed = (", ".join(sorted(each)) or "none" for each in (saved, shapes))
        raise GranflowError(
            f"The checkpoint holds the arrays {present}, but this scene needs {needed}. {OTHER_FEATURES}"
        )
    for name, shape in shapes.items():
        found = saved[name].shape
        if found[len(found) - len(shape) :] != shape:
            raise GranflowError(
                f"The checkpoint holds the array {name} of shape {found}, but this scene needs "
                f"{'x'.join(map(str, shape))} numbers in it. {OTHER_FEATURES}"
            )


def _load(field: Any, array: DeviceArray, values: np.ndarray | None) -> None:
    """Write an array to a field; the sum over the chunks to the first chunk, and zeros to the others."""
    if array.by_chunk:
        write_field(field, np.zeros((0, *array.full_shape[1:]), np.int64) if values is None else values[None])
    else:
        field.from_numpy(values)


def _sums(plan: Plan) -> dict[str, DeviceArray]:
    """Saved sums by name."""
    return saved_arrays(sum_arrays(plan))


def _dynamics(plan: Plan) -> dict[str, DeviceArray]:
    """Saved arrays of the force-controlled walls by name; empty without such walls."""
    return saved_arrays(wall_dynamics_arrays(plan)) if plan.controlled_motions else {}


def _deformation(plan: Plan) -> dict[str, DeviceArray]:
    """Saved arrays of the deforming box by name; empty with constant widths."""
    return saved_arrays(deformation_arrays(plan)) if plan.features.deforming_box else {}


# Particles of a checkpoint on the host, in the order of their ids.


def host_particles(state: State, saved: Mapping[str, Any]) -> HostParticles:
    """The particles of a checkpoint, in the order of their ids.

    saved:   with "particles" and "contacts" as in `engine.checkpoint.saved_state`
    Raises:  GranflowError if the scene needs other arrays
    """
    history = state.plan.history
    contacts = dict(saved["contacts"])
    arrays = saved_arrays(particle_arrays(state.plan))
    refuse_other_arrays(saved["particles"], {name: array.full_shape[1:] for name, array in arrays.items()})
    count = contacts.pop("count")
    partner = contacts.pop("partner")
    widths = {slot: (components,) for slot, components in history.items()}
    refuse_other_arrays(contacts, widths if len(partner) or contacts else {})
    contacts = contacts or {slot: np.zeros((0, components)) for slot, components in history.items()}
    particles = HostParticles(saved["particles"], Histories(count, partner, contacts))
    is_sorted = np.all(np.diff(saved["particles"]["id"]) > 0)
    return particles if is_sorted else particles.by_id()
