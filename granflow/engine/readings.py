"""What is read from a run on the device: clock, energies, snapshots, arrays of the particles."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil

import numpy as np

from granflow.engine.accounting import Accounting, mechanical_energy
from granflow.engine.clump_arrays import CLUMP_MOTION, synchronized_clumps
from granflow.engine.diagnosis import diagnose
from granflow.engine.exact_sums import exact_sum
from granflow.engine.force.collision_counts import collision_counts
from granflow.engine.force.contact_output import ContactOutput
from granflow.engine.force.contact_statistics import ContactStatistics
from granflow.engine.force.wall_forces import wall_impulses
from granflow.engine.frozen_masks import mobility_mask
from granflow.engine.host_copy import copy_to_host
from granflow.engine.limits import Change, Diagnosis
from granflow.engine.particle_sums import ParticleSums, device_sums, host_sums
from granflow.engine.snapshots import ordered_particles, wall_poses
from granflow.engine.stability_monitor import StabilityMonitor
from granflow.engine.state import State
from granflow.engine.stepper import Stepper
from granflow.engine.totals import ended_contacts_dissipation, totals_of
from granflow.fields import PARTICLE_QUANTITIES
from granflow.plan.plan import Plan
from granflow.snapshot import Snapshot

TIME_TOLERANCE = 1e-6
"""Tolerance for reaching a requested time, as a fraction of the time step."""

MOTION = ("mass", "radius", "position", "velocity", "angular_velocity", "force", "torque", *CLUMP_MOTION)
"""Fields that determine the mechanical energy at the time of the positions."""

CONTACT_COUNTS = ("coordination_number", "wall_contact_count")
"""Fields with the number of contacts of each particle."""


@dataclass(frozen=True)
class RestState:
    """How close the mobile particles are to rest.

    kinetic_energy:  mean translational and rotational kinetic energy [J] per particle
    unbalanced:      magnitude of the net force on all of them over their weight, which is the acceleration of the
                     center of mass over gravity: 1 in free fall, 0 in equilibrium; 0 without gravity
    """

    kinetic_energy: float
    unbalanced: float


class Readings:
    """The readable part of an engine: none of these functions changes the run, except for the records of `observe`."""

    plan: Plan
    state: State
    stepper: Stepper
    accounting: Accounting
    stability_monitor: StabilityMonitor
    energy_before_change: float | None
    _gravity: np.ndarray
    _started: bool
    _walls_changed: bool
    _stopping_change: Change | None
    _counts_contacts: bool

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
        return diagnose(code, particle, self.state, self.time, self._started, self._stopping_change)

    def _contact_energy(self) -> float:
        """Elastic energy and plastic dissipation [J] of the present contacts."""
        measured = self.state.built(ContactStatistics).measure(self.stepper.poses.index_at(self.step_count))
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

    def rest_state(self) -> RestState:
        """Mean kinetic energy and net force of the particles that are not fixed, the same for any order of them."""
        arrays, ranks = self._own_synchronized(MOTION), self.state.ranks
        kinetic, rotational, _ = mechanical_energy(arrays, self._gravity, ranks)
        mobile = mobility_mask(arrays)
        mobile_count = float(ranks.total(np.array([mobile.sum()]))[0])
        weight = exact_sum(arrays["mass"].astype(float) * mobile, ranks) * float(np.linalg.norm(self._gravity))
        net = [exact_sum(component * mobile, ranks) for component in arrays["force"].astype(float).T]
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
        """As `snapshot`, for observers of a run: also checks the stability and updates the largest energy input."""
        return self._snapshot(stage, quantities, observed=True)

    def _snapshot(self, stage: str, quantities: frozenset[str], observed: bool) -> Snapshot:
        poses = wall_poses(self.state) if "walls" in quantities else {}
        if quantities <= {"walls"}:
            count = {"particle_count": float(self.particle_count)}
            return Snapshot(self.time, self.step_count, stage, {}, None, poses, count)
        pose = self.stepper.poses.index_at(self.step_count)
        measured = self.state.built(ContactStatistics).measure(pose)
        arrays, sums = self._particles_and_sums("particles" in quantities)
        totals = totals_of(self.state, self.accounting, sums, measured)
        if observed:
            self.stability_monitor.check(self.time, sums.energies, self.accounting, totals, sums.speed)
        particles = ordered_particles(arrays, self.accounting) if "particles" in quantities else {}
        contacts = self.state.built(ContactOutput).take(self.stepper.ids(), pose) if "contacts" in quantities else None
        since_start = wall_impulses(self.state), collision_counts(self.state)
        return Snapshot(self.time, self.step_count, stage, particles, contacts, poses, totals, *since_start)

    def _particles_and_sums(self, needs_arrays: bool) -> tuple[dict[str, np.ndarray], ParticleSums]:
        """Arrays of a snapshot in device order if needed, and sums over the particles; a GPU adds them up by itself."""
        if not (needs_arrays or self.state.backend.on_cpu or self.plan.features.clumps):
            return {}, device_sums(self.state, 0.5 * self.time_step * self._started)
        own = self._own_synchronized(self._shown if needs_arrays else (*MOTION, *CONTACT_COUNTS))
        sums = host_sums(own, self._gravity, self.state.ranks)
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
        position, velocity = self.plan.periodic_box.wrap_with_velocity(
            arrays["position"], arrays["velocity"], self.time
        )
        return arrays | {"position": position, "velocity": velocity}

    def copied(self, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Fields on the host in device order, as they are on the device."""
        return self.state.ranks.gathered(copy_to_host(self.state, names))

    def synchronized(self, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Fields on the host in device order, with velocities and angular velocities at the time of the positions.

        names:    particle fields
        Returns:  arrays (n,) or (n, 3) by name, also of the fields that determine the velocities; fields that the scene
                  does not have are absent

            v(t) = v(t - dt/2) + dt F(t) / (2 m),   w(t) = w(t - dt/2) + dt M(t) / (2 I),   I = (2/5) m R^2

        Before the first step they are the initial values: a run that aborts there has not shifted them.
        """
        return self.state.ranks.gathered(self._own_synchronized(names))

    def _own_synchronized(self, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """As `synchronized`, of the particles of this process."""
        has_clumps = self.plan.features.clumps
        rotation = ("radius", "angular_velocity", "torque") if has_clumps or "angular_velocity" in names else ()
        clump_motion = CLUMP_MOTION if has_clumps else ()
        needed = ("mass", "velocity", "force", "fixed", *rotation, *clump_motion)
        arrays = copy_to_host(self.state, tuple(dict.fromkeys((*names, *needed))))
        if not self._started:
            return arrays
        clumps = synchronized_clumps(arrays, 0.5 * self.time_step, self._gravity)
        half = 0.5 * self.time_step * mobility_mask(arrays)[:, None]
        mass = arrays["mass"].astype(float)[:, None]
        arrays["velocity"] = arrays["velocity"] + half * arrays["force"] / mass
        if "angular_velocity" in arrays:
            inertia = 0.4 * mass * arrays["radius"].astype(float)[:, None] ** 2
            arrays["angular_velocity"] = arrays["angular_velocity"] + half * arrays["torque"] / inertia
        if clumps:
            in_clump = arrays["clump"][:, None] >= 0
            arrays |= {name: np.where(in_clump, values, arrays[name]) for name, values in clumps.items()}
        return arrays
