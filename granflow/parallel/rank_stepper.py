"""Time steps of one MPI rank.

All ranks take each step together: integration, exchange of ghosts, neighbor-list rebuild if any rank requests
it, contact forces. `RankStepper` runs the phases; `RankRebuild` does the rebuilds, in which particles migrate
between ranks.
"""

import time as clock
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from granflow.engine.clumps import body_positions, places_of_spheres
from granflow.engine.codes import ABORT_FAR, ABORT_LEFT_DOMAIN, ABORT_OVERLAP
from granflow.engine.host import (
    WITHOUT_HISTORY,
    HistoryTable,
    HostParticles,
    at_present,
    joined_arrays,
    particle_table,
    saved_particle_table,
)
from granflow.engine.neighbor.list import TOO_LONG
from granflow.engine.neighbor.phases import RebuildLaunch
from granflow.engine.neighbor.rebuild import ChunkKernel, RebuildKernel
from granflow.engine.neighbor.sort import KEPT_REACH, find_farthest, remaining
from granflow.engine.state import BATCH, LANES, Arrays, State
from granflow.engine.stepper import Stepper
from granflow.engine.totals import deleted_fields
from granflow.engine.wall_dynamics import mark_rebuild
from granflow.parallel.communicator import Communicator
from granflow.parallel.exchange import GhostExchange, LoadBalance, Share, migrated, migration_pays
from granflow.plan.capacities import GROWTH_FACTOR, REACH_STEPS


class RankStepper(Stepper):
    """As `Stepper`, for the particles of one rank; all ranks call each function together.

    Each phase of a step is a separate launch. The ranks agree on rebuilds, aborts and stop signals after the
    integration and after the forces, so that all of them take the same steps.

    `requested_stop`: number of the stop signal that this rank has received, otherwise 0. All ranks then have
    it as `stop_signal`, and the root ends the run.
    """

    def __init__(
        self, state: State, communicator: Communicator, on_deleted: Callable[[Arrays], None]
    ) -> None:
        self.requested_stop = 0
        self._communicator = communicator
        super().__init__(state, on_deleted)

    def _new_rebuild(self, on_deleted: Callable[[Arrays], None]) -> "RankRebuild":
        self._rank_rebuild = RankRebuild(self.state, self._communicator, on_deleted, self._grow_capacities)
        return self._rank_rebuild

    @property
    def pending(self) -> list[Arrays]:
        """Particles that the next rebuild appends, all saved fields."""
        return self._rank_rebuild.pending

    def holds(self, particle: int) -> bool:
        """Whether this rank owns the particle with this id, or has deleted it at the last rebuild."""
        return self._rank_rebuild.holds(particle)

    def update_ghosts(self) -> None:
        """Update the ghosts from their owners."""
        self._rank_rebuild.ghosts.update()

    def _attach(self, pose: int) -> None:
        """As `Stepper._attach`; the ghosts get the velocities from their owners."""
        super()._attach(pose)
        self.update_ghosts()

    def _grow_capacities(self, particles: int, needed: int, longest: int) -> None:
        """Increase the arrays to at least these capacities, and build all kernels again."""
        state = self.state
        self.timing.growth_count += 1
        if particles > state.plan.particle_capacity:
            state.plan = replace(state.plan, particle_capacity=particles)
        capacities = state.capacities.grown(max(needed, state.capacities.list_entries_per_segment), longest)
        if particles:
            planned = state.plan.capacities
            lists = max(planned.list_entries, planned.segments * capacities.list_entries_per_segment)
            capacities = replace(planned, list_entries=lists, batch=capacities.batch)
        state.grow_neighbor_list(capacities, self._compile)

    def forces(self, pose: int = 0, history_step: float | None = None) -> None:
        """As `Stepper.forces`; an abort of one rank becomes that of all."""
        super().forces(pose, history_step)
        self._agree()
        self._sum_wall_forces()

    def _sum_wall_forces(self) -> None:
        """Write the force of all ranks on each force-controlled wall as that of the first chunk of each
        rank."""
        if self.state.wall_dynamics is None:
            return
        field = self.state.wall_dynamics.wall_force
        by_chunk = field.to_numpy()
        total = self._communicator.sums(by_chunk[: self.state.wall_row_count].sum(axis=0))
        by_chunk[...] = 0
        by_chunk[0] = total
        field.from_numpy(by_chunk)

    def _agree(self, rebuild: bool = False) -> bool:
        """Whether any rank requests a rebuild; also agrees on an abort and a stop signal. Waits for the
        slowest rank."""
        is_due, self.stop_signal = self._rank_rebuild.ghosts.agree(self.requested_stop, rebuild)
        return is_due

    def _advance_once(self, steps: int, step: int) -> int:
        """Take one step; returns the number of completed steps, 0 after an abort."""
        state = self.state
        self._prepare_workers()
        self.poses.prepare(step, self.steps_since_rebuild)
        state.control.steps_done[0] = 0
        began = clock.perf_counter()
        rebuild_seconds = self.timing.neighbor_list
        self._write_force_inputs(step + 1)
        moving = self._launch_phase(forcing=0)
        with self._recorded("waiting"):
            is_due = self._agree(bool(state.control.rebuild_requested[0]))
        if not is_due or self.abort_code:  # a rebuild selects other ghosts
            with self._recorded("exchange"):
                self.update_ghosts()
        done = 0 if self.abort_code else self._finish_step(is_due, step, moving)
        self.poses.advance(done)
        self.timing.sampled_integration += moving
        self.timing.advance += clock.perf_counter() - began - (self.timing.neighbor_list - rebuild_seconds)
        self.timing.step_count += done
        self.timing.particle_steps += done * self._rank_rebuild.total_count
        return done

    @contextmanager
    def _recorded(self, phase: str) -> Iterator[None]:
        """Adds the wall-clock time of a block to a phase of `Timing`."""
        began = clock.perf_counter()
        yield
        setattr(self.timing, phase, getattr(self.timing, phase) + clock.perf_counter() - began)

    def _launch_phase(self, moving: int = 1, forcing: int = 1) -> float:
        """Launch one phase of a step; returns its wall-clock time [s]."""
        began = clock.perf_counter()
        self._launch_step(1, self.poses.next, self.state.clock.time_step, moving, forcing)
        return clock.perf_counter() - began

    def _finish_step(self, is_due: bool, step: int, moving: float) -> int:
        """Rebuild if it is due, and compute the forces; returns 1 if the step is complete, else 0.

        moving:  time [s] of the integration
        """
        if is_due:
            self._clear_loss_heat()
            self.rebuild_neighbor_lists(step + 1, self.poses.next)
            self._write_force_inputs(step + 1)
        with self._completing():
            forcing = self._launch_phase(moving=0)
        self._rank_rebuild.balance.record(moving + forcing)
        self.timing.sampled_forces += forcing
        with self._recorded("waiting"):
            self._agree()
        with self._recorded("exchange"):
            self._sum_wall_forces()
        if self.abort_code not in (0, ABORT_OVERLAP, ABORT_LEFT_DOMAIN):
            return 0
        if not is_due:
            self.steps_since_rebuild += 1
        return 1


# Neighbor-list rebuild: migration, ghosts and neighbor lists

UNUSED = -1
"""Id of array entries that contain no particle."""
MIGRATION_INTERVAL = 8
"""Rebuilds from one migration to the next, unless deletion, insertion, the number of ghosts or unequal times
of the ranks require it earlier."""
MORE_GHOSTS = 1.25
"""Ghosts of a rank over those after the last migration above which particles migrate."""
SEARCHED = ("position", "velocity", "radius", "reach", "fixed", "clump", "clump_position")
"""Fields from which a rebuild selects ghosts, and particles to delete."""


class RankRebuild:
    """Runs the rebuilds of one rank; all ranks rebuild together.

    When particles migrate, all of a rank pass through the host with their contact histories: sorting and
    selecting them takes a few steps' time. Most rebuilds keep the owned particles, and select new ghosts
    only.

    state:       device data of this rank
    on_deleted:  receives the arrays `deleted_fields` of the particles of all ranks that are deleted
    grow:        compiles all kernels again for arrays of larger capacities, (particles, list entries, longest
                 list)

    `pending`: particles that the next rebuild appends, all saved fields. `total_count`: particles of all
    ranks at the last rebuild. `balance`: decides which rank owns a particle.
    """

    def __init__(
        self,
        state: State,
        communicator: Communicator,
        on_deleted: Callable[[Arrays], None],
        grow: Callable[[int, int, int], None],
    ) -> None:
        self._state = state
        self._communicator = communicator
        self._on_deleted = on_deleted
        self._grow = grow
        self.ghosts = GhostExchange(state, communicator)
        self.pending: list[Arrays] = []
        self.total_count = 0
        self._histories = HistoryTable(state)
        self.balance = LoadBalance(communicator)
        self._ids: np.ndarray = np.zeros(0, np.int32)
        self._deleted: set[int] = set()
        self._rebuilds_left = 0
        self._ghosts_at_migration = 0

    def compile(self) -> None:
        """Compile the kernels, unless the state has them."""
        self._state.built(RebuildKernel).compile()
        self._prepare(0, 1, 0)

    def run(self, pose: int, workers: int) -> None:
        """Delete and migrate particles if necessary, select ghosts, and fill the neighbor lists.

        pose:     index of the wall poses at the time of the positions
        workers:  number of workers of the launch
        """
        state = self._state
        reach_time = REACH_STEPS * self._state.clock.time_step
        mark_rebuild(state)  # displacements of walls count from here
        if self._replace_ghosts(pose, workers, reach_time):
            self._fill(pose, workers, reach_time)
        else:
            began = clock.perf_counter()
            particles = self._taken()
            present, deleted = self._without_deleted(particles.arrays)
            self._list(particles, present, deleted, pose, workers, reach_time)
            self.balance.migration_seconds = clock.perf_counter() - began
        if int(state.control.abort[0]) == ABORT_FAR and state.count:
            find_farthest(state)

    def put(self, particles: HostParticles) -> None:
        """Take a part of the particles; the next rebuild distributes them."""
        raise NotImplementedError("the plan of MPI ranks does not change during a run")

    def restore(self, particles: HostParticles, pose: int, workers: int) -> None:
        """Put a part of the particles on each rank, with the neighbor lists of the last rebuild.

        pose, workers:  as for `run`; poses at the last rebuild
        """
        state = self._state
        earlier = particles.at_rebuild(state.plan.periodic_box.at(state.clock.time))
        none = {name: values[:0] for name, values in earlier.arrays.items()}
        share = self._list(earlier, np.arange(earlier.count), none, pose, workers, KEPT_REACH)
        saved_particle_table(state).put(slice(0, state.count), at_present(share.arrays))
        self.ghosts.update()

    def ids(self) -> np.ndarray:
        """Ids of the owned particles and the ghosts, by index."""
        return self._ids

    def _replace_ghosts(self, pose: int, workers: int, reach_time: float) -> bool:
        """Keep the owned particles and replace the ghosts; False, on all ranks, if particles must migrate.

        pose, workers, reach_time:  as for `_list`
        """
        state = self._state
        if not self._rebuilds_left:
            return False
        fits = self._prepare(pose, workers, state.count)
        owned = state.built(particle_table, SEARCHED).take(slice(0, state.count))
        entries = self.ghosts.selected(owned, reach_time)
        stays = fits and not self.pending and bool(remaining(state, owned).all())
        if not self._agree_to_keep(stays, [len(rows) for rows in entries]):
            return False
        self._rebuilds_left -= 1
        table = saved_particle_table(state)
        first = self.ghosts.first
        ghosts = self.ghosts.exchanged(entries, table.take)
        self._deleted = set()
        self._ids = np.concatenate([self._ids[:first], ghosts["id"]])
        table.put(slice(first, len(self._ids)), ghosts)
        self._histories.clear(slice(first, len(self._ids)))
        return True

    def _agree_to_keep(self, stays: bool, sent: list[int]) -> bool:
        """Whether no rank needs a migration.

        stays:  whether this rank needs none
        sent:   number of particles that it would send to each rank as ghosts
        """
        free = self._state.plan.capacities.particles - self.ghosts.first
        limit = min(free, int(MORE_GHOSTS * self._ghosts_at_migration) + self._state.plan.chunk_size)
        gathered = self._communicator.from_each((stays, limit, sent, self.balance.cost))
        all_stay, limits, numbers, costs = zip(*gathered, strict=True)
        return all(all_stay) and bool((np.sum(numbers, axis=0) <= limits).all()) and not migration_pays(costs)

    def _prepare(self, pose: int, workers: int, count: int) -> bool:
        """Wrap the owned particles and save their contact histories on the device; False if these do not
        fit."""
        state = self._state
        launch = state.built(ChunkKernel).launch
        if launch is None:
            return True
        launch(
            *RebuildLaunch(
                workers=workers,
                particle_count=count,
                skin=state.plan.skin,
                dt=state.clock.time_step,
                pose=pose,
            )
        )
        return int(state.control.list_length_needed[0]) <= state.capacities.saved_entries_per_segment

    def _list(
        self,
        particles: HostParticles,
        present: np.ndarray,
        deleted: Arrays,
        pose: int,
        workers: int,
        reach_time: float,
    ) -> Share:
        """Distribute the particles over the ranks, and fill the neighbor lists; returns those of this rank.

        present:     (k,) indices of the particles that are not deleted
        deleted:     of this rank
        reach_time:  [s], see `engine.neighbor.sort.Bounds`
        """
        share = self._share(particles, present)
        entries = self.ghosts.selected(share.arrays, reach_time)
        ghosts = self.ghosts.exchanged(
            entries, lambda rows: {name: each[rows] for name, each in share.arrays.items()}
        )
        self._rebuilds_left = MIGRATION_INTERVAL - 1
        self._ghosts_at_migration = self.ghosts.count
        self._place(share, ghosts, deleted)
        self._fill(pose, workers, reach_time)
        return share

    def holds(self, particle: int) -> bool:
        """Whether this rank owns the particle with this id, or has deleted it at the last rebuild."""
        return particle in self._ids[: self._state.count] or particle in self._deleted

    def _taken(self) -> HostParticles:
        """The particles of the device and the pending ones, in the periodic box."""
        state = self._state
        pending = self.pending
        self.pending = []
        arrays = joined_arrays([saved_particle_table(state).take(slice(0, state.count)), *pending])
        # Integration has wrapped all but pending particles.
        arrays["position"][...] = state.plan.periodic_box.at(state.clock.time).wrap(arrays["position"])
        return HostParticles(arrays, self._histories.listed(self._ids, len(arrays["id"])))

    def _without_deleted(self, owned: Arrays) -> tuple[np.ndarray, Arrays]:
        """Indices of the particles that remain, and the others, see `engine.neighbor.deletion`."""
        stays = remaining(self._state, owned)
        deleted = {name: values[~stays] for name, values in owned.items()}
        names = [name for name in deleted_fields(self._state.plan) if name in deleted]
        all_deleted = joined_arrays(self._communicator.from_each({name: deleted[name] for name in names}))
        if len(all_deleted["id"]):
            self._on_deleted(all_deleted)
        return np.flatnonzero(stays), deleted

    def _share(self, particles: HostParticles, present: np.ndarray) -> Share:
        """The particles that this rank owns from now on."""
        plan = self._state.plan
        communicator = self._communicator
        self.total_count = int(communicator.sums(np.array([len(present)]))[0])
        position = body_positions(particles.arrays)[present].astype(float)
        contacts = self._contacts(particles)[present]
        owners = self.balance.owners(position, contacts)
        return migrated(communicator, particles, present, owners, 2.0 * plan.radius_max + plan.skin)

    def _contacts(self, particles: HostParticles) -> np.ndarray:
        """Number (n,) of contacts in the list of each particle; without a history, that of candidate
        pairs."""
        neighbors = self._state.neighbors
        listed = self._state.count
        if neighbors.history:
            return particles.histories.count
        found = np.zeros(particles.count, np.int64)
        found[:listed] = neighbors.list_end.to_numpy()[:listed] - neighbors.list_begin.to_numpy()[:listed]
        return found

    def _place(self, share: Share, ghosts: Arrays, deleted: Arrays) -> None:
        """Write owned particles, contact histories and ghosts to the device.

        Entries between the particles and the ghosts repeat the last owned particle. Deleted particles are
        behind the ghosts, for the diagnosis of an abort.
        """
        state = self._state
        count = len(share.rows)
        ghost_count = len(ghosts["id"])
        first = -(-count // state.plan.chunk_size) * state.plan.chunk_size
        end = first + ghost_count
        self._grow_arrays(end + len(deleted["id"]), sum(len(each.partner) for each in share.histories))
        state.count = count
        self.ghosts.first = first
        state.cell_sort.owned_count[0] = count
        state.cell_sort.ghost_first[0] = first
        gap = np.full(first - count, count - 1)
        between = {name: values[gap] for name, values in share.arrays.items()}
        between["id"] = np.full(len(gap), UNUSED, np.int32)
        table = saved_particle_table(state)
        begin = 0
        for part in (share.arrays, between, ghosts, deleted):
            table.put(slice(begin, begin + len(part["id"])), part)
            begin += len(part["id"])
        if state.plan.features.clumps:
            places = places_of_spheres(share.arrays["id"], share.arrays["clump"])
            state.built(particle_table, tuple(places)).put(slice(0, count), places)
        without = np.full(len(gap), WITHOUT_HISTORY)
        self._histories.write(
            share.histories, np.concatenate([share.rows, without, share.ghost_rows(ghosts["id"])])
        )
        self._ids = np.concatenate([share.arrays["id"], between["id"], ghosts["id"]])
        self._deleted = {*deleted["id"].tolist()}

    def _grow_arrays(self, particles: int, histories: int) -> None:
        """Increase the capacities of all ranks if one of them has more particles or histories than fit."""
        capacities = self._state.capacities
        per_segment = -(-histories // capacities.segments)
        particles, per_segment = self._communicator.largest_of(np.array([particles, per_segment])).tolist()
        more_particles = particles > self._state.plan.capacities.particles
        more_histories = per_segment > capacities.saved_entries_per_segment
        if more_particles or more_histories:
            entries = capacities.list_capacity_for(per_segment) if more_histories else 0
            self._grow(int(GROWTH_FACTOR * particles) if more_particles else 0, entries, 0)

    def _fill(self, pose: int, workers: int, reach_time: float) -> None:
        """Fill the neighbor lists; again after they have grown on all ranks, if one of them is too short."""
        state = self._state
        while True:
            kernel = state.built(RebuildKernel)
            needed = 0
            control = state.control
            if state.count:
                launch = RebuildLaunch(
                    workers=workers,
                    particle_count=self.ghosts.first + self.ghosts.count,
                    skin=state.plan.skin,
                    reach_time=reach_time,
                    dt=state.clock.time_step,
                    pose=pose,
                )
                kernel.launch(*launch)
                needed = int(control.list_length_needed[0])
            control.rebuild_due[0] = control.rebuild_requested[0] = 0
            too_long, length = divmod(needed, TOO_LONG)
            needs = np.array([length, length if too_long else 0])
            length, longest = self._communicator.largest_of(needs).tolist()
            if length <= state.capacities.list_entries_per_segment and not longest:
                return
            self._grow(0, length, longest and longest + BATCH + LANES)
