"""The particles of a simulation, read and changed from Python while it runs.

`simulation.particles` is a `LiveParticles`; each of its properties is a `ParticleArray`, which reads from the
device and writes to it. Particles are added as arrays that follow from the arguments of `LiveParticles.add`.
All values are checked before they are written; a check raises GranflowError with one sentence.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from granflow.arguments import shown
from granflow.engine.engine import Engine
from granflow.engine.host import present_indices, remove_particles, write_particles
from granflow.engine.settings import set_property
from granflow.engine.totals import content_fields, deleted_fields
from granflow.errors import GranflowError
from granflow.geometry.sphere import sphere_mass
from granflow.particles.group import ParticleData, SceneGroup
from granflow.plan.plan import Plan
from granflow.runs.run_state import RunState
from granflow.scene.checks import pair_name, possible_contacts
from granflow.schema.messages import suggestion_sentence

# Arrays of properties


class ParticleArray(NDArrayOperatorsMixin):
    """One property of all particles, in the order of their ids: a reference to the simulation, not an array
    of its own.

    Reading copies the present values from the device: indexing, `np.asarray`, arithmetic and comparisons
    return independent numpy arrays, which later steps do not change. Assigning to an index
    (`velocity[mask] = 0`, `velocity[mask, 2] *= 0.5`), and in-place operators (`velocity *= 0.5`), write
    through. Writing to a copy (`velocity[mask][0] = 1`) has no effect on the simulation.

    `owner`, `name`: particles and name of the property; `read`: function that returns a new array; `write`:
    function that writes an array of the same shape, or None if the property is read-only.
    """

    def __init__(
        self,
        owner: object,
        name: str,
        read: Callable[[], np.ndarray],
        write: Callable[[np.ndarray], None] | None = None,
    ) -> None:
        self._owner = owner
        self._name = name
        self._read = read
        self._write = write

    def is_of(self, owner: object, name: str) -> bool:
        """Whether this is the property `name` of these particles."""
        return self._owner is owner and self._name == name

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self._read(), dtype=dtype)

    def __getitem__(self, index: Any) -> Any:
        return self._read()[index]

    def __setitem__(self, index: Any, values: Any) -> None:
        """Write values; raises GranflowError for a read-only property, a wrong shape, or values that are not
        valid."""
        present = self._read()
        if self._write is None:
            raise GranflowError(f"particles.{self._name} is read-only.")
        is_text = present.dtype.kind == "U"
        changed = present.astype(object) if is_text else present.copy()
        try:
            changed[index] = np.asarray(values) if is_text else real_array(f"particles.{self._name}", values)
        except (ValueError, IndexError, TypeError) as error:
            shape = np.shape(values)
            selected = _shape(present, index)
            if selected is None or shape in ((), selected):
                raise GranflowError(
                    f"particles.{self._name}, of the shape {present.shape}: {error}."
                ) from None
            remedy = (
                f"; give the transpose of the values, of the shape {selected}"
                if shape == selected[::-1]
                else ""
            )
            raise GranflowError(
                f"particles.{self._name}: values of the shape {shape} are given for {selected}{remedy}."
            ) from None
        self._write(changed)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **keywords: Any) -> Any:
        """Apply a function of numpy to copies; with `out`, write the result."""
        arrays = [np.asarray(each) if isinstance(each, ParticleArray) else each for each in inputs]
        (out,) = keywords.pop("out", (None,))
        if not isinstance(out, ParticleArray):
            return getattr(ufunc, method)(*arrays, **keywords, **({} if out is None else {"out": out}))
        out[...] = getattr(ufunc, method)(*arrays, **keywords)
        return out

    def __len__(self) -> int:
        return len(self._read())

    def __iter__(self) -> Iterator[Any]:
        """Iterate over copies that are read-only, because writing to them has no effect on the simulation."""
        values = self._read()
        values.flags.writeable = False
        return iter(values)

    def __setattr__(self, name: str, value: Any) -> None:
        """Raises AttributeError: a name cannot be assigned, only an index."""
        if not name.startswith("_"):
            raise AttributeError(
                f"particles.{self._name}.{name} cannot be set: assign to particles.{self._name}[...]."
            )
        super().__setattr__(name, value)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape (n,) or (n, 3) for the present number of particles."""
        return self._read().shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the copies."""
        return self._read().dtype

    def __getattr__(self, name: str) -> Any:
        """Attributes and methods of a copy, such as `mean`. Raises AttributeError for unknown and private
        ones."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._read(), name)

    def __repr__(self) -> str:
        return f"particles.{self._name}: {self._read()!r}"


def _shape(values: np.ndarray, index: Any) -> tuple[int, ...] | None:
    """Shape of the indexed part of an array; None for an index that does not exist."""
    try:
        return np.shape(values[index])
    except (IndexError, TypeError):
        return None


# The particles

LARGER = 2
"""Factor by which the capacity grows if there is no space for added particles."""


class LiveParticles:
    """The particles of a simulation; all arrays are ordered by id and have one entry per present particle.

        simulation.particles.velocity[simulation.particles.group == "feed"] *= 0.5

    Reading copies from the device, writing copies to it; see `ParticleArray`. No array is a view of device
    memory, because particles are sorted by cell there. A change takes effect at once for later reads;
    neighbor lists and forces are computed again before the next step or snapshot, once for all changes. The
    change of energy is part of `removed_energy`. Writing raises GranflowError for values that are not valid.
    """

    def __init__(self, state: RunState) -> None:
        self._state = state

    @property
    def _engine(self) -> Engine:
        return self._state.engine

    def __len__(self) -> int:
        """Number of present particles."""
        return len(present_indices(self._engine.state))

    def __repr__(self) -> str:
        return f"<{len(self)} particles at {self._engine.time:.6g} s>"

    def __setattr__(self, name: str, value: Any) -> None:
        """Assignment to a property writes all particles; the result of an in-place operator is already
        written."""
        attribute = getattr(type(self), name, None)
        if not name.startswith("_") and not isinstance(attribute, property):
            known = [
                key for key, each in vars(type(self)).items() if isinstance(each, property) and key[0] != "_"
            ]
            raise AttributeError(
                f"particles has no property {name}. {suggestion_sentence(name, known, 'properties')}"
            )
        if isinstance(attribute, property) and attribute.fset is None:
            getattr(self, name)[...] = value  # raises: the property follows from others
        super().__setattr__(name, value)

    def _assign(self, name: str, value: Any) -> None:
        """Write all particles; the result of an in-place operator is already written."""
        if not (isinstance(value, ParticleArray) and value.is_of(self, name)):
            getattr(self, name)[...] = value

    @property
    def id(self) -> ParticleArray:
        """Ids (n,) int64, ascending; an id is never used again. Read-only."""
        return ParticleArray(self, "id", lambda: self._field("id").astype(np.int64))

    @property
    def position(self) -> ParticleArray:
        """Centers (n, 3) [m]; in a periodic box inside the box."""
        return ParticleArray(self, "position", lambda: self._motion()[0], self._write_position)

    @position.setter
    def position(self, value: Any) -> None:
        self._assign("position", value)

    @property
    def velocity(self) -> ParticleArray:
        """Velocities (n, 3) [m/s] at the time of the positions."""
        return ParticleArray(self, "velocity", lambda: self._motion()[1], self._write_velocity)

    @velocity.setter
    def velocity(self, value: Any) -> None:
        self._assign("velocity", value)

    @property
    def angular_velocity(self) -> ParticleArray:
        """Angular velocities (n, 3) [rad/s]; zero and read-only in a scene without torques (every pair has
        friction and rolling friction 0) whose groups have no initial angular velocity."""
        has_rotation = self._engine.plan.features.rotation
        write = self._write_angular_velocity if has_rotation else None
        return ParticleArray(self, "angular_velocity", self._angular_velocity, write)

    @angular_velocity.setter
    def angular_velocity(self, value: Any) -> None:
        self._assign("angular_velocity", value)

    @property
    def diameter(self) -> ParticleArray:
        """Diameters (n,) [m], between those of the scene; the mass follows from the density."""
        return ParticleArray(self, "diameter", lambda: 2.0 * self._field("radius"), self._write_diameter)

    @diameter.setter
    def diameter(self, value: Any) -> None:
        self._assign("diameter", value)

    @property
    def temperature(self) -> ParticleArray:
        """Temperatures (n,) [K]. Raises GranflowError in a scene without contact.heat."""
        self._refuse_without_temperature()
        return ParticleArray(
            self, "temperature", lambda: self._field("temperature").astype(float), self._write_temperature
        )

    @temperature.setter
    def temperature(self, value: Any) -> None:
        self._assign("temperature", value)

    @property
    def mass(self) -> ParticleArray:
        """Masses (n,) [kg]. Read-only: they follow from diameter and material."""
        return ParticleArray(self, "mass", lambda: self._field("mass").astype(float))

    @property
    def force(self) -> ParticleArray:
        """Total forces (n, 3) [N] at the present positions, with the weight, but on spheres of clumps without
        it.

        Read-only.
        """
        return ParticleArray(self, "force", self._force)

    @property
    def group(self) -> ParticleArray:
        """Names (n,) of the groups; a new group must have the same material, and be mobile or fixed alike."""
        return ParticleArray(self, "group", lambda: self._names("group"), self._write_group)

    @group.setter
    def group(self, value: Any) -> None:
        self._assign("group", value)

    @property
    def material(self) -> ParticleArray:
        """Names (n,) of the materials. Read-only: the material is that of the group."""
        return ParticleArray(self, "material", lambda: self._names("material"))

    def rows(self, ids: Sequence[int] | np.ndarray) -> np.ndarray:
        """Indices (k,) into the arrays of particles with these ids (k,). Raises GranflowError if one is
        absent.

        simulation.particles.velocity[simulation.particles.rows([3, 7])] = 0.0
        """
        wanted = np.atleast_1d(real_array("particles.rows: ids", ids))
        present = np.asarray(self.id)
        rows = np.searchsorted(present, wanted)
        absent = wanted[(rows >= len(present)) | (present[np.minimum(rows, len(present) - 1)] != wanted)]
        if len(absent):
            raise GranflowError(f"particles.rows: no particle has the id {absent[0]:.10g}.")
        return rows

    def add(
        self,
        position: Any,
        diameter: Any = None,
        material: str | None = None,
        velocity: Any = (0.0, 0.0, 0.0),
        group: str | None = None,
        angular_velocity: Any = (0.0, 0.0, 0.0),
        **others: Any,
    ) -> np.ndarray:
        """Add k particles and return their ids (k,).

        position:          (k, 3) [m], or (3,) for one particle
        diameter:          (k,) or a number [m], between those of the scene; default: that of the group
        material:          name; default: that of the group
        velocity:          (k, 3) or (3,) [m/s]
        group:             name of a group of the scene; default: the only one, of the material if that is
                           given
        angular_velocity:  (k, 3) or (3,) [rad/s]
        Raises:            GranflowError for arguments that are not valid; no particle is added then

        If there is no space for them, the arrays grow to twice their size, which may compile the kernels
        again.
        """
        refuse_other_arguments(others)
        engine = self._engine
        new = particle_data(self._state.plan, position, diameter, material, velocity, group, angular_velocity)
        refuse_without_pair(self._state.plan, self._counts_with(new.group))
        engine.begin_change()
        needed = engine.state.count + len(new) + self._state.insertion.remaining
        if needed > self._state.plan.particle_capacity:
            capacity = max(needed, LARGER * self._state.plan.particle_capacity)
            self._state.plan = replace(self._state.plan, particle_capacity=capacity)
            self._state.prepare()
        first = self._engine.accounting.inserted_count
        self._engine.insert(new)
        return np.arange(first, first + len(new))

    def remove(self, mask: Any) -> None:
        """Remove the particles of a mask (n,), or of indices (k,) into the arrays; ids: see `rows`.

        Of a clump, all spheres are removed.
        """
        engine = self._engine
        indices = present_indices(engine.state)
        try:
            removed = indices[np.asarray(mask)]
        except (IndexError, TypeError, ValueError) as error:
            raise GranflowError(
                f"particles.remove: {error}, but there are {len(indices)} particles."
            ) from None
        if np.size(removed):
            engine.begin_change()
            removed = self._with_clumps(np.unique(removed), indices)
            arrays = engine.copied(deleted_fields(engine.plan))
            engine.accounting.count_removed({name: values[removed] for name, values in arrays.items()})
            self._count_contents("deleted", removed)
            remove_particles(engine.state, removed)

    def _count_contents(self, change: str, indices: np.ndarray) -> None:
        """Count the contents of particles (k,), such as their heat, as deleted or inserted."""
        engine = self._engine
        arrays = engine.copied(content_fields(engine.plan))
        chosen = {name: values[indices] for name, values in arrays.items()}
        engine.accounting.change_contents(engine.plan, change, chosen)

    def _with_clumps(self, chosen: np.ndarray, present: np.ndarray) -> np.ndarray:
        """Device indices `chosen`, with all spheres of their clumps; `present`: of all particles."""
        if not self._engine.plan.features.clumps:
            return chosen
        clump = self._engine.copied(("clump",))["clump"]
        found = clump[chosen]
        others = np.isin(clump[present], found[found >= 0])
        return np.union1d(chosen, present[others])

    def _refuse_in_clumps(self, name: str, rows: np.ndarray) -> None:
        """Raise GranflowError if one of the particles, indices (k,) into the arrays, is in a clump."""
        if not self._engine.plan.features.clumps:
            return
        clump = self._field("clump")[rows]
        if np.any(clump >= 0):
            raise GranflowError(
                f"particles.{name}: particle {np.asarray(self.id)[rows][clump >= 0][0]} is a sphere of a "
                "clump, which moves as one body; leave those of clumps unchanged."
            )

    def _refuse_unequal_in_clumps(self, name: str, values: np.ndarray) -> None:
        """Raise GranflowError unless all spheres of each clump have the same of the values (n,)."""
        if not self._engine.plan.features.clumps:
            return
        ids = np.asarray(self.id)
        clump = self._field("clump")
        first = values[np.searchsorted(ids, np.where(clump >= 0, clump, ids))]
        unequal = np.flatnonzero(values != first)
        if len(unequal):
            k = unequal[0]
            raise GranflowError(
                f"particles.{name}: sphere {ids[k]} would have {values[k]:.6g}, and sphere {clump[k]} of the "
                f"same clump {first[k]:.6g}; give all spheres of a clump the same {name}."
            )

    def _field(self, name: str) -> np.ndarray:
        """A particle field in the order of ids."""
        state = self._engine.state
        return self._engine.copied((name,))[name][present_indices(state)]

    def _motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities (n, 3), float64, in the order of ids."""
        engine = self._engine
        arrays = engine.synchronized(("position", "velocity"))
        order = present_indices(engine.state)
        position = arrays["position"][order].astype(float)
        velocity = arrays["velocity"][order].astype(float)
        return engine.state.periodic_box.wrap_with_velocity(position, velocity, engine.time)

    def _angular_velocity(self) -> np.ndarray:
        """Angular velocities (n, 3), float64; zero without rotation."""
        engine = self._engine
        values = engine.synchronized(("angular_velocity",)).get(
            "angular_velocity", np.zeros((engine.state.count, 3))
        )
        return values[present_indices(engine.state)].astype(float)

    def _force(self) -> np.ndarray:
        """Forces (n, 3) at the present positions, of the forces that are present now."""
        self._state.begin()
        self._state.prepare()
        if self._engine.is_changed:
            self._engine.refresh()
        return self._field("force").astype(float)

    def _names(self, kind: str) -> np.ndarray:
        """Names (n,) of the groups or materials."""
        plan = self._engine.plan
        names = [group.name for group in plan.groups] if kind == "group" else list(plan.scene.materials)
        return np.array(names)[self._engine.accounting.by_id(kind, self._field("id"))]

    def _write(self, name: str, values: np.ndarray, **others: np.ndarray) -> None:
        """Write the entries of a field that differ from the present ones, and other fields with it."""
        engine = self._engine
        if name == "radius":
            present = np.asarray(self.diameter)
            compared = 2.0 * values
        else:
            present = np.asarray(getattr(self, name))
            compared = values
        rows = np.flatnonzero((present != compared).reshape(len(present), -1).any(axis=1))
        is_content = name in [each.name for each in engine.plan.scene.equations]
        if not is_content:  # a property that all spheres of a clump have in common
            self._refuse_in_clumps("diameter" if name == "radius" else name, rows)
        engine.begin_change()
        if is_content:
            set_property(
                engine.state, engine.accounting, name, present_indices(engine.state)[rows], values[rows]
            )
            return
        arrays = {name: values, **others}
        indices = present_indices(engine.state)[rows]
        if "mass" in others:
            self._count_contents("deleted", indices)
        write_particles(engine.state, indices, {key: array[rows] for key, array in arrays.items()})
        if "mass" in others:
            self._count_contents("inserted", indices)

    def _write_position(self, values: np.ndarray) -> None:
        in_domain(self._engine.plan, "particles.position", finite("particles.position", values))
        self._write("position", values)

    def _write_velocity(self, values: np.ndarray) -> None:
        self._refuse_motion("velocity", finite("particles.velocity", values))
        self._write("velocity", values)

    def _write_angular_velocity(self, values: np.ndarray) -> None:
        self._refuse_motion("angular_velocity", finite("particles.angular_velocity", values))
        self._write("angular_velocity", values)

    def _refuse_motion(self, name: str, values: np.ndarray) -> None:
        """Raise GranflowError if the velocity of a fixed particle would change."""
        fixed = self._is_fixed(self._numbers("group"))
        if np.any(values[fixed] != np.asarray(getattr(self, name))[fixed]):
            raise GranflowError(
                f"particles.{name}: forces and programs do not move particles of a fixed group; leave theirs "
                "unchanged."
            )

    def _refuse_without_temperature(self) -> None:
        """Raise GranflowError if the particles have no temperature."""
        if "temperature" not in [each.name for each in self._engine.plan.scene.equations]:
            raise GranflowError(
                "particles.temperature: the particles have none, because contact.heat is none; write "
                "contact.heat: conduction in the scene."
            )

    def _write_temperature(self, values: np.ndarray) -> None:
        if len(finite("particles.temperature", values)) and values.min() <= 0.0:
            raise GranflowError(
                f"particles.temperature would be {values.min():.6g} K, but a temperature is above 0 K."
            )
        held = self._engine.plan.held_values.get("temperature")
        if held is not None:
            of_wall = np.array([np.nan if each is None else each for each in held])[self._numbers("group")]
            moved = np.flatnonzero(~np.isnan(of_wall) & (values != of_wall))
            if len(moved):
                raise GranflowError(
                    f"particles.temperature: particle {np.asarray(self.id)[moved[0]]} is attached to a wall "
                    f"and has its temperature, {of_wall[moved[0]]:.6g} K; leave it unchanged."
                )
        self._refuse_unequal_in_clumps("temperature", values)
        self._write("temperature", values)

    def _write_diameter(self, values: np.ndarray) -> None:
        plan = self._engine.plan
        finite("particles.diameter", values)
        if len(values) and not (
            2.0 * plan.radius_min <= values.min() and values.max() <= 2.0 * plan.radius_max
        ):
            raise GranflowError(
                f"particles.diameter would lie in [{values.min():.6g}, {values.max():.6g}] m, but the "
                "diameters of the scene, on which time step and neighbor lists depend, in "
                f"[{2 * plan.radius_min:.6g}, {2 * plan.radius_max:.6g}] m."
            )
        density = np.array([each.density for each in plan.scene.materials.values()])
        radius = 0.5 * values
        self._write("radius", radius, mass=sphere_mass(radius, density[self._numbers("material")]))

    def _write_group(self, values: np.ndarray) -> None:
        """Change the groups in the accounting, and on the device if groups pass through walls."""
        groups = self._engine.plan.groups
        names = [group.name for group in groups]
        numbers = np.array([named("particles.group", str(name), names) for name in values], dtype=np.int32)
        materials = np.array([group.material_number for group in groups])
        if np.any(materials[numbers] != self._numbers("material")) or np.any(
            self._fixing(numbers) != self._fixing(self._numbers("group"))
        ):
            raise GranflowError(
                "particles.group: the new group must have the same material, and be mobile or fixed in the "
                "same way."
            )
        shapes = np.array([group.spec.shape.body is not None for group in groups])
        changed = np.flatnonzero(numbers != self._numbers("group"))
        self._refuse_in_clumps("group", changed)
        if np.any(shapes[numbers[changed]]):
            raise GranflowError("particles.group: a sphere cannot change to a group of clumps.")
        if self._engine.plan.features.wall_groups:
            self._write("group", values, group=numbers)
        self._engine.accounting.set_group(self._field("id"), numbers)

    def _numbers(self, kind: str) -> np.ndarray:
        """Numbers (n,) of the groups or materials in the scene."""
        return self._engine.accounting.by_id(kind, self._field("id"))

    def _counts_with(self, added: np.ndarray) -> np.ndarray:
        """Number of particles of each group: present, to be inserted, and `added`, their group numbers."""
        plan = self._state.plan
        pending = self._state.insertion.results()
        counts = np.bincount([*self._numbers("group"), *added], minlength=len(plan.groups))
        waiting = [pending.get(group.name, {}).get("not_inserted_count", 0.0) for group in plan.groups]
        return counts + np.array(waiting, dtype=np.int64)

    def _is_fixed(self, groups: np.ndarray) -> np.ndarray:
        """Whether each group number (n,) is that of a fixed group."""
        return np.array([group.spec.fixed for group in self._engine.plan.groups])[groups]

    def _fixing(self, groups: np.ndarray) -> np.ndarray:
        """For each group number (n,), equal numbers for groups that are mobile, or fixed to the same wall."""
        walls = np.array(self._engine.plan.attached_walls)
        return (walls + self._is_fixed(np.arange(len(walls))))[groups]


# Added particles: arguments to arrays

ARGUMENTS = ("position", "diameter", "material", "velocity", "group", "angular_velocity")
"""Arguments of `LiveParticles.add`."""


def refuse_other_arguments(given: Iterable[str]) -> None:
    """Raise GranflowError for the first of these arguments, which `LiveParticles.add` does not have."""
    for name in given:
        remedy = "Give diameter, twice the radius."
        if name != "radius":
            remedy = suggestion_sentence(name, ARGUMENTS, "arguments")
        raise GranflowError(f"particles.add has no argument {name}. {remedy}")


def particle_data(
    plan: Plan,
    position: Any,
    diameter: Any,
    material: str | None,
    velocity: Any,
    group: str | None,
    angular_velocity: Any,
) -> ParticleData:
    """Arrays of new particles from the arguments of `LiveParticles.add`. Raises GranflowError."""
    count = _particle_count(position)
    number = _group_number(plan, material, group)
    chosen = plan.groups[number]
    if chosen.spec.shape.body is not None:
        raise GranflowError(
            f"group is {chosen.name}, whose particles are clumps, but particles.add has spheres: insert "
            "clumps by the scene."
        )
    position = array_of("position", position, count, 3)
    in_domain(plan, "position", position)
    velocity = array_of("velocity", velocity, count, 3)
    angular_velocity = array_of("angular_velocity", angular_velocity, count, 3)
    if chosen.spec.fixed and (velocity.any() or angular_velocity.any()):
        raise GranflowError(
            f"group is {chosen.name}, which is fixed: leave out velocity and angular_velocity."
        )
    if angular_velocity.any() and not plan.features.rotation:
        raise GranflowError(
            "angular_velocity is not 0, but the particles of this scene do not rotate, because every pair "
            "has friction and rolling friction 0: leave it out, or give a pair friction."
        )
    return ParticleData(
        position=position,
        velocity=velocity,
        angular_velocity=angular_velocity,
        radius=0.5 * _diameters(plan, chosen, diameter, count),
        material=np.full(count, chosen.material_number, dtype=np.int32),
        group=np.full(count, number, dtype=np.int32),
    )


def _particle_count(position: Any) -> int:
    """Number of positions in an argument: (k, 3), or (3,) for one particle."""
    centers = np.asarray(position, dtype=object)
    if centers.shape == (3,):
        return 1
    return len(centers) if centers.ndim else 0


def refuse_without_pair(plan: Plan, counts: np.ndarray) -> None:
    """Raise GranflowError if particles can be in contact without constants of their pair.

    `counts`: number of particles of each group: present, added, and to be inserted.
    """
    mobile = Counter[str]()
    fixed = Counter[str]()
    for group, count in zip(plan.groups, counts, strict=True):
        if count:
            counted = fixed if group.spec.fixed else mobile
            counted[group.spec.material] += int(count)
    for both, reason in possible_contacts(mobile, fixed, walls={}).items():
        if (min(both), max(both)) not in plan.pair_materials:
            raise GranflowError(
                f"{reason} now, but the scene has no pair {pair_name(both)}; add it to pairs."
            )


def _group_number(plan: Plan, material: str | None, group: str | None) -> int:
    """Number of the group: given, or the only one of the material, or of the scene."""
    names = [each.name for each in plan.groups]
    materials = [each.spec.material for each in plan.groups]
    if material is not None:
        named("material", material, list(dict.fromkeys(materials)))
    if group is None and material is None and len(names) > 1:
        raise GranflowError(f"group is missing: give one of {', '.join(names)}.")
    if group is None and material is not None and materials.count(material) > 1:
        both = [name for name, each in zip(names, materials, strict=True) if each == material]
        raise GranflowError(f"group is missing: {', '.join(both)} are of {material}.")
    if group is None:
        return 0 if material is None else materials.index(material)
    number = named("group", group, names)
    if material not in (None, materials[number]):
        raise GranflowError(f"material is {material!r}, but the group {group} is of {materials[number]}.")
    return number


def _diameters(plan: Plan, group: SceneGroup, given: Any, count: int) -> np.ndarray:
    """Diameters (count,) [m]: given, or that of the group. Those of the scene bound them."""
    low, high = group.spec.diameters
    if given is None and low < high:
        raise GranflowError(
            f"diameter is missing: the group {group.name} has diameters from {low:.6g} to {high:.6g} m."
        )
    diameter = array_of("diameter", low if given is None else given, count, None)
    smallest = 2.0 * plan.radius_min
    largest = 2.0 * plan.radius_max
    outside = (diameter < smallest) | (diameter > largest)
    if outside.any():
        raise GranflowError(
            f"diameter contains {diameter[outside][0]:.6g} m, but the diameters of the scene, on which time "
            f"step and neighbor lists depend, lie in [{smallest:.6g}, {largest:.6g}] m."
        )
    return diameter


# Checks of values

LARGEST = 1e30
"""Largest magnitude of a number [SI], as in a scene; squares of larger ones overflow in single precision."""


def real_array(name: str, given: Any) -> np.ndarray:
    """The numbers in a value as a new float64 array of any shape.

    Raises GranflowError for what is not real numbers: text, None, truth values, complex numbers, masked
    entries.
    """
    try:
        values = np.array(given)
        if values.dtype.kind not in "iuf" and not (
            values.dtype.kind == "O" and None not in values.ravel().tolist()
        ):
            raise TypeError
        if np.ma.is_masked(given):
            raise GranflowError(f"{name} has masked entries, whose values are unknown: fill them.")
        return values.astype(np.float64)
    except (ValueError, TypeError, OverflowError):
        kind = "complex numbers" if np.iscomplexobj(given) else shown(given)
        raise GranflowError(
            f"{name} is {kind}, but must be real numbers, such as 0.5 or [0, 0, 1]."
        ) from None


def finite(name: str, values: np.ndarray) -> np.ndarray:
    """The values, all of which must be finite and of a magnitude that occurs."""
    if not np.isfinite(values).all():
        first = values[~np.isfinite(values)].flat[0]
        raise GranflowError(f"{name} contains {first}; all values must be finite.")
    if (np.abs(values) > LARGEST).any():
        first = values[np.abs(values) > LARGEST].flat[0]
        raise GranflowError(f"{name} contains {first:g}; a value of this magnitude is out of range.")
    return values


def array_of(name: str, given: object, count: int, width: int | None) -> np.ndarray:
    """An array (count,) or (count, width) of finite numbers, from one entry for all or one for each."""
    shape = (count,) if width is None else (count, width)
    values = real_array(name, given)
    if values.shape not in (shape, shape[1:]):
        remedy = f"; give its transpose, {name}.T" if values.ndim == 2 and width == len(values) else ""
        raise GranflowError(
            f"{name} has the shape {values.shape}, but must have {shape} or {shape[1:]}{remedy}."
        )
    return finite(name, np.broadcast_to(values, shape).copy())


def in_domain(plan: Plan, name: str, position: np.ndarray) -> None:
    """Positions (n, 3) [m] must be inside the domain, unless it expands."""
    if plan.scene.domain.on_exit == "expand":
        return
    outside = np.any((position < plan.domain_low) | (position > plan.domain_high), axis=1)
    if outside.any():
        point = [float(x) for x in position[outside][0]]
        low = [float(x) for x in plan.domain_low]
        high = [float(x) for x in plan.domain_high]
        raise GranflowError(f"{name} contains {point} m, which is outside the domain from {low} to {high} m.")


def named(what: str, name: str, names: Sequence[str]) -> int:
    """The index of a name among `names`."""
    if name not in names:
        raise GranflowError(f"{what} is {name!r}, but must be one of {', '.join(names)}.")
    return list(names).index(name)
