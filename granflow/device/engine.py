"""The device as the simulation sees it: insert grains, set walls, advance, take a snapshot."""

from collections.abc import Sequence
from math import ceil, pi

import numpy as np

from granflow.device.approach import FastestApproach
from granflow.device.backend import Backend
from granflow.device.blame import trip_behind
from granflow.device.books import Books, ledger_totals, mechanical_energy
from granflow.device.drive import drive_totals, driven_offsets
from granflow.device.fixed import free_shares
from granflow.device.guards import GUARD_LEFT, Trip
from granflow.device.loads import wall_impulses
from granflow.device.records import ContactRecords
from granflow.device.state import State
from granflow.device.stepper import Stepper, Timing
from granflow.device.survey import Survey
from granflow.device.transfer import Transfer
from granflow.device.watch import Watch, largest_speed
from granflow.plan import Plan
from granflow.plan.outlets import taken_by
from granflow.plan.pace import STEPS_BETWEEN_LOOKS
from granflow.scene.generate import Grains
from granflow.snapshot import Snapshot, WallPose
from granflow.walls.motion import Motion, pose

SAME_TIME = 1e-6
"""Share of a step by which a moment may miss a time that it is meant to be."""


class Engine:
    """One plan running on one backend, with time kept by the state's clock."""

    def __init__(self, plan: Plan, backend: Backend) -> None:
        self.plan = plan
        self.state = State(plan, backend)
        self.stepper = Stepper(self.state, self._on_gone)
        self._build_looks()
        self.books = Books(outlets={drain.name: [0.0, 0.0] for drain in plan.drains})
        self.watch = Watch(plan)
        self.steps_since_look = 0
        self._gravity = np.array(plan.gravity)
        self._walls_changed = False
        self._begun = False

    def _build_looks(self) -> None:
        """Kernels that move data in and out; they know the fields, which growing replaces."""
        self._looks_growth = self.timing.growth_count
        self._transfer = Transfer(self.state)
        self._survey = Survey(self.state)
        self._records: ContactRecords | None = None
        self._approach = FastestApproach(self.state) if self.plan.pace is not None else None

    def _follow_growth(self) -> None:
        if self._looks_growth != self.timing.growth_count:
            self._free_looks()
            self._build_looks()

    def _free_looks(self) -> None:
        for each in (self._survey, self._records, self._approach):
            if each is not None:
                each.block.free()

    @property
    def transfer(self) -> Transfer:
        """Copies between host arrays and particles."""
        self._follow_growth()
        return self._transfer

    @property
    def survey(self) -> Survey:
        """Contact statistics."""
        self._follow_growth()
        return self._survey

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.state.clock.time

    @property
    def step_count(self) -> int:
        """Steps done."""
        return self.state.clock.step_count

    @property
    def time_step(self) -> float:
        """Time step [s] now."""
        return self.state.clock.time_step

    @property
    def mean_time_step(self) -> float:
        """Time step [s], the mean of all steps done where it follows the scene."""
        follows = self.plan.pace is not None and self.step_count > 0
        return self.time / self.step_count if follows else self.plan.time_step

    def steps_to(self, time: float) -> int:
        """Steps of the present length that end at this time [s] or just behind it."""
        return ceil((time - self.time) / self.time_step - SAME_TIME)

    def reached(self, time: float) -> bool:
        """Whether the present moment is the one nearest to this time [s], or later."""
        return self.time >= time - 0.5 * self.time_step

    @property
    def timing(self) -> Timing:
        """Wall seconds by phase."""
        return self.stepper.timing

    @property
    def tripped(self) -> bool:
        """Whether a guard tripped."""
        return bool(self.stepper.guard_code)

    @property
    def trip(self) -> Trip | None:
        """The guard that tripped, if one did, with who is behind it: that is looked up anew at every call."""
        code = self.stepper.guard_code
        if not code:
            return None
        particle = int(self.state.control.guard_particle[0])
        return trip_behind(code, particle, self.state, self.transfer, self.time, self._begun)

    def insert(self, grains: Grains) -> None:
        """Put grains in at the present time; their forces come with the next `refresh`."""
        if not len(grains):
            return
        scene, books, count = self.plan.scene, self.books, len(grains)
        density = np.array([scene.materials[name].density for name in scene.materials])
        number = np.array([self._plan_number(name) for name in scene.materials])
        fixed = np.array([group.fixed for group in scene.particles.values()])[grains.group]
        arrays = {
            "id": books.inserted_count + np.arange(count),
            "material": number[grains.material],
            "fixed": fixed.astype(np.int32),
            "radius": grains.radius,
            "mass": 4.0 / 3.0 * pi * grains.radius**3 * density[grains.material],
            "position": grains.position,
            "velocity": grains.velocity,
            "spin": grains.spin,
        }
        books.brought_energy += sum(mechanical_energy(arrays, self._gravity))
        if self._begun:
            fallen = 0.5 * self.time_step * self._gravity
            arrays["velocity"] = grains.velocity - free_shares(arrays)[:, None] * fallen
        self.transfer.append(arrays)
        books.inserted_count += count
        books.material.append(grains.material)
        books.group.append(grains.group)

    def set_walls(self, present: Sequence[bool], motions: Sequence[Sequence[Motion]]) -> None:
        """Say which walls are there and how they move; takes effect with the next `refresh`."""
        self.state.wall_motions = tuple(tuple(each) for each in motions)
        for index, there in enumerate(present):
            self.state.walls.present[index] = int(there)
            pivot = pose(self.state.wall_motions[index], np.array([self.time])).pivot
            self.state.walls.pivot[index] = pivot.tolist()
        self._walls_changed = True

    def refresh(self) -> None:
        """Search and forces anew, after grains or walls came or went.

        The first one also sets velocities half a step back, where the leapfrog has them. What contacts hold with a
        wall that appears among the grains, or vanishes, counts as brought or taken away.
        """
        counted = self.plan.features.ledger and self._walls_changed
        before = self._contact_energy() if counted else 0.0
        self.stepper.refresh(self.step_count)
        if counted:
            self.books.brought_energy += self._contact_energy() - before
        self._walls_changed = False
        if not self._begun and not self.tripped:
            self._begun = True
            self.transfer.kick(-0.5 * self.time_step)
        self._keep_pace()

    def _contact_energy(self) -> float:
        """Energy that the contacts there are have taken up, to give back or for good [J]."""
        self.stepper.stand_walls(self.step_count)
        measured = self.survey.measure()
        return measured["elastic_energy"] + measured["plastic_dissipation"]

    def advance(self, steps: int) -> None:
        """Do `steps` steps; fewer if a guard trips, a stop is requested or the time step changes."""
        clock, before = self.state.clock, self.time_step
        wanted = clock.step_count + steps
        while clock.step_count < wanted and self.time_step == before and not (self.tripped or self.stepper.interrupted):
            allowed = wanted - clock.step_count
            if self.plan.pace is None:
                clock.step_count += self.stepper.advance(allowed, clock.step_count)
            else:
                self._advance_to_look(min(allowed, STEPS_BETWEEN_LOOKS - self.steps_since_look))

    def _advance_to_look(self, steps: int) -> None:
        """Do up to `steps` steps; choose the time step anew if a look is due then."""
        searches = self.timing.search_count
        done = self.stepper.advance(steps, self.state.clock.step_count)
        self.state.clock.step_count += done
        self.steps_since_look += done
        if self.steps_since_look >= STEPS_BETWEEN_LOOKS or self.timing.search_count > searches:
            self._keep_pace()

    def _keep_pace(self) -> None:
        """Choose the time step for the scene as it is now, where it follows the scene.

        Velocities, half a step behind, are brought to half a step of the new length.
        """
        pace = self.plan.pace
        self.steps_since_look = 0
        if pace is None or self.tripped:
            return
        self.stepper.stand_walls(self.step_count)
        self._follow_growth()
        assert self._approach is not None
        step = pace.step_for(self._approach.measure(), float(np.linalg.norm(self._gravity)) * self.time_step)
        if step != self.time_step:
            self.transfer.kick(0.5 * (self.time_step - step))
            self.state.clock.change(step)

    def go_on(self, steps_since_look: int) -> None:
        """Take the run as begun: its clock, particles, walls and contacts have been put back."""
        self.steps_since_look = steps_since_look
        self._begun, self._walls_changed = True, False

    def mean_kinetic_energy(self) -> float:
        """Mean kinetic energy per particle that can move, of centres and spins [J]."""
        arrays = self.synchronized(("mass", "radius", "position", "velocity", "spin", "force", "torque"))
        kinetic, rotational, _ = mechanical_energy(arrays, self._gravity)
        return (kinetic + rotational) / max(free_shares(arrays).sum(), 1.0)

    def snapshot(self, stage: str, wants: frozenset[str]) -> Snapshot:
        """What stands on the device now; `wants` as for observers. Contacts are not surveyed if nothing rests on it."""
        if wants <= {"walls"}:
            count = {"particle_count": float(self.state.count)}
            impulses = wall_impulses(self.state)
            return Snapshot(self.time, self.step_count, stage, {}, None, self.wall_poses(), count, impulses)
        self.stepper.stand_walls(self.step_count)
        measured = self.survey.measure()
        names = ("id", "radius", "mass", "position", "velocity", "spin", "force", "torque", "coordination")
        arrays = self.synchronized(names)
        totals = self._totals(arrays, measured)
        arrays["position"], arrays["velocity"] = self.plan.border.brought_in(
            arrays["position"], arrays["velocity"], self.time
        )
        particles = self._particle_arrays(arrays) if "particles" in wants else {}
        contacts = self._contact_arrays(arrays) if "contacts" in wants else None
        poses, impulses = self.wall_poses(), wall_impulses(self.state)
        return Snapshot(self.time, self.step_count, stage, particles, contacts, poses, totals, impulses)

    def wall_poses(self) -> dict[str, WallPose]:
        """Pose of every wall now, by name."""
        found, driven = {}, driven_offsets(self.state)
        for index, wall in enumerate(self.plan.walls):
            poses = pose(self.state.wall_motions[index], np.array([self.time]))
            present = bool(self.state.walls.present[index])
            found[wall.name] = WallPose(present, poses.offset[0] + driven[index], poses.rotation[0], poses.pivot)
        return found

    def free(self) -> None:
        """Give the device's memory back."""
        self._free_looks()
        self.state.free()

    def _plan_number(self, material: str) -> int:
        return self.plan.materials.index(material) if material in self.plan.materials else 0

    def _on_gone(self, first: int, last: int) -> None:
        """Enter particles that left the domain, or were taken by an outlet, into the books."""
        arrays = self.transfer.taken(("id", "mass", "radius", "position", "velocity", "spin", "fixed"), first, last)
        left = self._taken_by_outlets(arrays) < 0
        if self.plan.scene.domain.leaving == "error" and left.any():
            self.state.control.guard[0] = GUARD_LEFT
            self.state.control.guard_particle[0] = int(arrays["id"][left].min())
        kinetic, rotational, potential = mechanical_energy(arrays, self._gravity)
        self.books.deleted_count += last - first
        self.books.deleted_mass += float(arrays["mass"].sum(dtype=float))
        self.books.removed_energy += kinetic + rotational + potential
        self.books.removed_kinetic_energy += kinetic + rotational

    def _taken_by_outlets(self, arrays: dict[str, np.ndarray]) -> np.ndarray:
        """Which outlet took each deleted particle (n,), -1 for none; their counts and masses go into the books."""
        position, drains = arrays["position"], self.plan.drains
        if not drains:
            return np.full(len(position), -1)
        kept = [axis for axis in range(3) if self.plan.scene.domain.leaving != "grow"]
        low, high = self.plan.domain_low[kept], self.plan.domain_high[kept]
        in_domain = np.all((position[:, kept] >= low) & (position[:, kept] <= high), axis=1)
        taken = taken_by(drains, position.astype(float), in_domain)
        for index, drain in enumerate(drains):
            mine = taken == index
            self.books.outlets[drain.name][0] += float(mine.sum())
            self.books.outlets[drain.name][1] += float(arrays["mass"][mine].sum(dtype=float))
        return taken

    def synchronized(self, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Fields on the host, velocities and spins brought forward to the time of the positions.

        Before the first step they are those of the start: a run that aborts there has not set them half a step back.
        """
        arrays = self.transfer.taken((*names, "fixed"))
        if not self._begun:
            return arrays
        half = 0.5 * self.time_step * free_shares(arrays)[:, None]
        mass = arrays["mass"].astype(float)[:, None]
        arrays["velocity"] = arrays["velocity"] + half * arrays["force"] / mass
        if "spin" in arrays:
            inertia = 0.4 * mass * arrays["radius"].astype(float)[:, None] ** 2
            arrays["spin"] = arrays["spin"] + half * arrays["torque"] / inertia
        return arrays

    def _particle_arrays(self, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        order = np.argsort(arrays["id"], kind="stable")
        found = {name: values[order] for name, values in arrays.items()}
        found["id"] = found["id"].astype(np.int64)
        found["coordination_number"] = found.pop("coordination")
        for name in ("material", "group"):
            found[name] = self.books.by_id(name, found["id"])
        for name in ("spin", "torque"):
            found.setdefault(name, np.zeros_like(found["velocity"]))
        return found

    def _contact_arrays(self, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        self._follow_growth()
        if self._records is None:
            self._records = ContactRecords(self.state)
        return self._records.take(arrays)

    def _totals(self, arrays: dict[str, np.ndarray], measured: dict[str, float]) -> dict[str, float]:
        books, count = self.books, self.state.count
        energies = mechanical_energy(arrays, self._gravity)
        contacts, free = measured["contact_count"], free_shares(arrays)
        totals = {
            "particle_count": float(count),
            "inserted_count": float(books.inserted_count),
            "deleted_count": float(books.deleted_count),
            "deleted_mass": books.deleted_mass,
            "contact_count": contacts,
            "kinetic_energy": energies[0],
            "rotational_energy": energies[1],
            "overlap_mean": measured["overlap_sum"] / contacts if contacts else 0.0,
            "overlap_largest": measured["overlap_largest"],
            "coordination_number": float(free @ arrays["coordination"]) / max(free.sum(), 1.0),
        }
        if self.plan.features.shear:
            totals["shear_strain"] = self.plan.border.strain(self.time)
        if books.waiting_count is not None:
            totals["waiting_count"] = float(books.waiting_count)
        for name, (outlet_count, outlet_mass) in books.outlets.items():
            totals |= {f"outlet_count.{name}": outlet_count, f"outlet_mass.{name}": outlet_mass}
        if self.plan.features.ledger:
            totals |= ledger_totals(self.state, books, energies, measured)
        totals |= drive_totals(self.state)
        self.watch.look(self.time, energies, books, totals, largest_speed(arrays["velocity"]))
        return totals
