"""Forces from Python: device functions that act on the particles of a simulation.

A `ParticleForce` has a function, which is compiled into the kernel of the time step, and `ForceParameters`,
which may change while the simulation runs. `Forces` is `simulation.forces`: it puts the forces into the plan.
"""

from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import replace
from inspect import isfunction, signature
from typing import Any

import numpy as np

from granflow.arguments import GuardedList, refuse_other, shown
from granflow.device_functions import reason_of
from granflow.engine.backend import Backend
from granflow.engine.particle_forces import compile_alone
from granflow.errors import FunctionError, GranflowError
from granflow.live.particles import finite, real_array
from granflow.plan.plan import ExternalForce, ParameterValue, Plan
from granflow.runs.run_state import RunState


class ForceParameters(MutableMapping[str, ParameterValue]):
    """Values of the parameters of a force by name: numbers, or vectors of three components; SI units.

    A new value of the same kind takes effect with the next step, without compilation. Raises GranflowError
    for other names or values that are not valid.
    """

    def __init__(self, force: str, values: Mapping[str, Any]) -> None:
        refuse_other(
            f"{force}: parameters", values, Mapping, 'a mapping of names to numbers, such as {"k": 0.5}'
        )
        self._force = force
        self._values = dict[str, ParameterValue]()
        for name, value in values.items():
            if not (isinstance(name, str) and name.isidentifier()):
                raise GranflowError(f"{force}: the parameter {name!r} must be named like a Python variable.")
            self._values[name] = self._checked(name, value)

    def __getitem__(self, name: str) -> ParameterValue:
        return self._values[name]

    def __setitem__(self, name: str, value: Any) -> None:
        if name not in self._values:
            names = ", ".join(self._values) or "none"
            raise GranflowError(f"{self._force} has no parameter {name}; its parameters are {names}.")
        checked = self._checked(name, value)
        self.refuse_other_kind(name, checked)
        self._values[name] = checked

    def refuse_other_kind(self, name: str, value: ParameterValue) -> None:
        """Raise GranflowError for a vector in place of a number, or the reverse."""
        if isinstance(value, tuple) != isinstance(self._values[name], tuple):
            raise GranflowError(f"{self._force}: the parameter {name} must remain a {self._kind(name)}.")

    def __delitem__(self, name: str) -> None:
        """Raises GranflowError: the function reads all parameters."""
        raise GranflowError(f"{self._force}: the parameter {name} cannot be removed.")

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return repr(self._values)

    def _kind(self, name: str) -> str:
        return "vector of three components" if isinstance(self._values[name], tuple) else "number"

    def _checked(self, name: str, value: Any) -> ParameterValue:
        """The value as a number or a tuple. Raises GranflowError."""
        array = real_array(f"{self._force}: the parameter {name}", value)
        if array.shape not in ((), (3,)) or not np.isfinite(array).all():
            raise GranflowError(
                f"{self._force}: the parameter {name} is {shown(value)}, but must be a finite number or a "
                "vector of three."
            )
        finite(f"{self._force}: the parameter {name}", array)
        return float(array) if array.shape == () else (float(array[0]), float(array[1]), float(array[2]))


ARGUMENTS = ("position", "velocity", "radius", "mass", "time", "parameters")
"""Arguments of the function of a force, in order."""


class ParticleForce:
    """A force on each particle, from a device function that is compiled into the kernel of the time step.

        def drag(position, velocity, radius, mass, time, parameters):
            return -6.0 * 3.141592653589793 * parameters.viscosity * radius * velocity

        simulation.forces.append(granflow.ParticleForce(drag, parameters={"viscosity": 1.8e-5}))

    function:    Python function or `ti.func` (position [m], velocity [m/s], radius [m], mass [kg], time [s],
                 parameters) -> force [N]; position, velocity and result are vectors of three components. It
                 may call other `ti.func`s and has one return statement. Position and velocity are those at
                 `time`.
    parameters:  numbers and vectors by name, which the function reads as `parameters.NAME`
    name:        in messages and checkpoints; default: name of the function

    `parameters` may be changed while the simulation runs: `force.parameters["viscosity"] = 2e-5`. Raises
    GranflowError for parameters that are not valid.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        parameters: Mapping[str, Any] | None = None,
        name: str | None = None,
    ) -> None:
        if not callable(function):
            raise GranflowError(f"ParticleForce requires a function, not {function!r}.")
        refuse_other("name", name, (str, type(None)), 'a text, such as "drag"')
        self._function = function
        self._name: str = name or str(getattr(function, "__name__", type(function).__name__))
        _refuse_other_arguments(self.name, function)
        if getattr(function, "__name__", "") == "<lambda>":
            raise GranflowError("ParticleForce cannot compile a lambda: define the function with def.")
        self._parameters = ForceParameters(f"force {self.name}", {} if parameters is None else parameters)

    def __setattr__(self, name: str, value: object) -> None:
        """Assign the parameters. Raises AttributeError for another attribute, which would have no effect."""
        if name != "parameters" and not name.startswith("_"):
            raise AttributeError(
                f"ParticleForce.{name} cannot be set: assign to its parameters, or remove the force from "
                "simulation.forces and append another one."
            )
        super().__setattr__(name, value)

    @property
    def function(self) -> Callable[..., Any]:
        """The device function."""
        return self._function

    @property
    def name(self) -> str:
        """Name in messages and checkpoints."""
        return self._name

    @property
    def parameters(self) -> ForceParameters:
        """Values of the parameters by name; a mapping with the same names may be assigned.

        Raises GranflowError for other names or values that are not valid; no value is changed then.
        """
        return self._parameters

    @parameters.setter
    def parameters(self, values: Mapping[str, Any]) -> None:
        given = ForceParameters(f"force {self.name}", values)
        if [*given] != [*self._parameters] and set(given) != set(self._parameters):
            raise GranflowError(
                f"force {self.name}: the parameters are {', '.join(given) or 'none'}, but must remain "
                f"{', '.join(self._parameters) or 'none'}, which its function is compiled for."
            )
        for name, value in given.items():
            self._parameters.refuse_other_kind(name, value)
        self._parameters.update(given)

    @property
    def planned(self) -> ExternalForce:
        """The force in a plan, with the values of this object."""
        layout = tuple(
            (name, 3 if isinstance(value, tuple) else 1) for name, value in self.parameters.items()
        )
        return ExternalForce(self.name, self.function, layout, self.parameters)

    def __repr__(self) -> str:
        return f"ParticleForce({self.name}, {self.parameters!r})"


def _refuse_other_arguments(name: str, function: Callable[..., Any]) -> None:
    """Raise GranflowError for a Python function that does not take ARGUMENTS."""
    if not isfunction(function):
        return
    given = list(signature(function).parameters)
    if len(given) != len(ARGUMENTS):
        raise GranflowError(
            f"force {name} takes ({', '.join(given)}), but must take ({', '.join(ARGUMENTS)})."
        )


class Forces(GuardedList[ParticleForce]):
    """The forces of a simulation; `append` and `remove` take effect with the next step, which compiles the
    kernels.

    Without forces, nothing is compiled and no time is spent. The work of all forces is `external_work` in the
    energy budget.
    """

    _name = "forces"

    def __init__(self, state: RunState, forces: Sequence[ParticleForce]) -> None:
        self._state = state
        self._items = tuple(forces)

    def __repr__(self) -> str:
        return repr(list(self._items))

    def append(self, force: ParticleForce) -> None:
        """Add a force. Raises FunctionError if its function cannot be compiled, GranflowError if its name
        exists."""
        forces = (*self._items, force)
        refuse_invalid(forces)
        check_compiled(force, self._state.engine.state.backend, self._state.engine.time)
        self._set(forces)

    def remove(self, force: ParticleForce) -> None:
        """Remove a force. Raises GranflowError if it is not in the list."""
        if force not in self._items:
            raise GranflowError(f"{shown(force)} is not a force of this simulation.")
        self._set(tuple(each for each in self._items if each is not force))

    def _set(self, forces: tuple[ParticleForce, ...]) -> None:
        """Change the plan; the velocities are at the time of the positions when forces begin and end."""
        self._state.engine.begin_change()
        self._items = forces
        self._state.plan = _with_forces(self._state.plan, forces)


def plan_with_forces(plan: Plan, forces: Sequence[ParticleForce], backend: Backend) -> Plan:
    """The plan with forces from the start. Raises GranflowError, or FunctionError for a function that is not
    valid."""
    if not forces:
        return plan
    refuse_invalid(forces)
    for force in forces:
        check_compiled(force, backend, 0.0)
    return _with_forces(plan, forces)


def refuse_invalid(forces: Sequence[ParticleForce]) -> None:
    """Raise GranflowError for an object that is not a force, or for a second force of the same name."""
    for force in forces:
        if not isinstance(force, ParticleForce):
            raise GranflowError(f"A ParticleForce is required, not {shown(force)}.")
    names = [force.name for force in forces]
    for name in {name for name in names if names.count(name) > 1}:
        raise GranflowError(f"The simulation has two forces {name}: give one of them another name=.")


def check_compiled(force: ParticleForce, backend: Backend, time: float) -> None:
    """Compile the function of a force at `time` [s] by itself. Raises FunctionError."""
    try:
        compile_alone(backend, force.planned)
    except Exception as error:
        reason = reason_of(error, force.function)
        raise FunctionError(
            f"The force {force.name} at {time:.6g} s cannot be compiled: {reason}."
        ) from error


def _with_forces(plan: Plan, forces: Sequence[ParticleForce]) -> Plan:
    """The plan with these forces; their arrays remain without forces, because they contain the work."""
    features = replace(plan.features, external_forces=True)
    return replace(plan, features=features, external_forces=tuple(each.planned for each in forces))
