"""Registration of contact models from outside the package."""

from granflow.contact import registry
from granflow.contact.model import ContactModel
from granflow.scene import partial
from granflow.scene.schema import contact, materials
from granflow.scene.schema.fields import Model
from granflow.scene.schema.scene import SceneInput


def register_contact_model(model: ContactModel) -> None:
    """Register a contact model, so that scenes can select it like a built-in one.

    Call it before a scene with the model is read, also in a program that resumes a run. Scenes that exist are not
    affected. Raises ValueError for a record that is not valid, or a name that exists.
    """
    registry.add(model)
    _use_registry()


def unregister_contact_model(model: ContactModel) -> None:
    """Remove a contact model that was registered."""
    registry.remove(model)
    _use_registry()


def _use_registry() -> None:
    """Rebuild the schema from the registry."""
    contact.use_registry()
    materials.use_registry()
    blocks: list[type[Model]] = [contact.Contact, materials.MaterialPair, SceneInput, *SceneInput.__subclasses__()]
    for block in blocks:
        block.model_rebuild(force=True)
    partial.clear_schema()
