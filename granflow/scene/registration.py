"""Registration of contact models and metrics from outside the package.

A model is checked, added to the registry of contact models, and becomes a value of `contact` in the schema; a
metric becomes a kind of `output.metrics`.
"""

from inspect import unwrap

from granflow.arguments import refuse_other, shown
from granflow.contact import registry
from granflow.contact.law import SLOTS, ContactModel
from granflow.contact.particle_equation import ParticleEquation
from granflow.device_functions import run_time_branches, source_lines
from granflow.errors import GranflowError
from granflow.scene import checks, reference
from granflow.scene.blocks import contact, materials, metrics, output, particles, run, settings
from granflow.scene.blocks.scene import SceneInput
from granflow.scene.blocks.walls import kinds
from granflow.schema.model import Model


def register_contact_model(model: ContactModel) -> None:
    """Register a contact model, so that scenes can select it like a built-in one.

    Call it before a scene with the model is read, also in a program that resumes a run. Scenes that exist are
    not affected. The guide "Simulations in Python" lists its functions.

        gf.register_contact_model(ContactModel(MyCohesion, "what it does, in one sentence"))

    Raises GranflowError for a record that is not valid, or a name that exists.
    """
    refuse_other("model", model, ContactModel, "a ContactModel with a law, see the guide")
    if not (
        isinstance(model.law, type) and issubclass(model.law, tuple(slot.base for slot in SLOTS.values()))
    ):
        bases = ", ".join(slot.base.__name__ for slot in SLOTS.values())
        raise GranflowError(
            f"the law of a contact model is {shown(model.law)}, but must be a subclass of {bases}."
        )
    _refuse_without_source(model)
    _refuse_branches(model)
    try:
        registry.add(model)
    except ValueError as error:
        raise GranflowError(str(error)) from None
    _use_registry()


def register_particle_equation(equation: ParticleEquation) -> None:
    """Register the equation of a particle property that contacts change, such as a temperature.

    It acts in scenes whose contact models have the flows that it reads. Call it before a scene is read, also
    in a program that resumes a run. The guide "Simulations in Python" has an example.

        gf.register_particle_equation(Temperature())

    Raises GranflowError for an equation that is not valid, or a name that exists.
    """
    refuse_other("equation", equation, ParticleEquation, "a ParticleEquation, see the guide")
    keys = {field.alias or key for key, field in particles.Group.model_fields.items()}
    name = getattr(equation, "name", None)
    if name in keys - {each.name for each in registry.equations()}:
        raise GranflowError(f"particle equation {equation.name}: a key of particle groups has this name.")
    try:
        source_lines(unwrap(type(equation).rate))
        registry.add_equation(equation)
    except ValueError as error:
        raise GranflowError(str(error)) from None
    _use_registry()


def unregister_particle_equation(equation: ParticleEquation) -> None:
    """Remove an equation that was registered."""
    registry.remove_equation(equation)
    _use_registry()


def _refuse_without_source(model: ContactModel) -> None:
    """Raise GranflowError if the text of a device function, which is compiled, is not available."""
    for name in ("force", "torque", "flow"):
        try:
            source_lines(unwrap(getattr(model.law, name, registry.add)))
        except ValueError as error:
            raise GranflowError(f"contact model {model.law.__name__}: {error}") from None


VECTORIZED = ("force", "viscous_force", "torque", "limit", "tangential_stiffness", "damping", "attraction")
"""Device functions that are evaluated for many contacts at once."""


def _refuse_branches(model: ContactModel) -> None:
    """Raise GranflowError for a branch in a vectorized function, or a called function without source."""
    if not getattr(model.law, "branch_free", True):
        return
    for name in VECTORIZED:
        if not hasattr(model.law, name):
            continue
        try:
            places = list(run_time_branches(getattr(model.law, name)))
        except ValueError as error:
            raise GranflowError(f"contact model {model.law.__name__}: {error}") from None
        if places:
            remedy = "use ti.select"
            if hasattr(model.law, "branch_free"):
                remedy += ", or set branch_free = False"
            raise GranflowError(
                f"contact model {model.law.__name__}: {places[0]}: {name} has a branch that depends on the "
                f"contact, in a loop that must be vectorized; {remedy}"
            )


def unregister_contact_model(model: ContactModel) -> None:
    """Remove a contact model that was registered."""
    registry.remove(model)
    _use_registry()


def register_metric(metric: type[metrics.Metric]) -> None:
    """Register a kind of metric, so that scenes can measure it like a built-in one.

    `metric`: subclass of `granflow.scene.blocks.metrics.Metric` with the field `kind`, fields for its other
    keys, `quantities` and `measure`. Call this function before a scene with the metric is read, also in a
    program that resumes a run. Scenes that exist are not affected.

        class Height(Metric):
            kind: Literal["elevation"] = Field("elevation", description="kind of metric")
            quantities = (Quantity("mean_height", "z", "m", "mean height of the particles"),)

            def measure(self, snapshot, scene):
                return Reading({"mean_height": snapshot.particles["position"][:, 2].mean()})

        gf.register_metric(Height)

    Raises GranflowError for a class that is not valid, or a name that exists.
    """
    if not (isinstance(metric, type) and issubclass(metric, metrics.Metric)):
        raise GranflowError(
            f"metric is {shown(metric)}, but must be a subclass of granflow.scene.blocks.metrics.Metric, see "
            "the guide."
        )
    try:
        metrics.add_metric(metric)
    except ValueError as error:
        raise GranflowError(str(error)) from None
    _use_registry()


def unregister_metric(metric: type[metrics.Metric]) -> None:
    """Remove a kind of metric that was registered."""
    metrics.remove_metric(metric)
    _use_registry()


def _use_registry() -> None:
    """Rebuild the schema from the registries."""
    contact.use_registry()
    materials.use_registry()
    output.use_metrics()
    particles.use_registry()
    settings.use_registry()
    kinds.use_registry()
    blocks: list[type[Model]] = [
        contact.Contact,
        materials.Material,
        *kinds.WALLS,
        particles.Group,
        settings.StageSetting,
        run.Stage,
        materials.MaterialPair,
        output.Output,
        SceneInput,
        *SceneInput.__subclasses__(),
    ]
    for block in blocks:
        block.model_rebuild(force=True)
    checks.clear_schema()
    reference.clear_schema()
