"""Liquid content of the particle groups, and parts of a scene that cannot be combined with liquid transfer."""

from collections.abc import Iterator

from granflow.contact import registry
from granflow.scene.document import KeyPath
from granflow.scene.partial import PartialScene
from granflow.scene.schema.faults import Fault, missing, whole


def transfer(parts: PartialScene) -> Iterator[Fault]:
    """Every group requires a liquid content with a cohesion model that transfers liquid, and vice versa.

    With `contact.cohesion: none` the content is unused. Clumps and earlier runs have no films.
    """
    scene, name = parts.scene, parts.scene.contact.name("cohesion")
    transfers = name in registry.liquid_models()
    for group_name, group in scene.particles.items():
        path: KeyPath = ("particles", group_name, "liquid_content")
        if transfers and group.liquid_content is None:
            yield missing(
                path, f"contact.cohesion is {name}; give the volume of the film over that of a particle, or 0"
            )
        elif transfers and group.clump is not None:
            yield whole(("particles", group_name, "clump"), f"cannot be combined with contact.cohesion: {name}")
        elif group.liquid_content and not transfers and name != "none":
            remedy = f"remove liquid_content, or choose {' or '.join(registry.liquid_models())}"
            yield Fault(path, f"contact.cohesion is {name}; {remedy}")
    if transfers and scene.start_from is not None:
        reason = f"cannot be combined with contact.cohesion: {name}: it reads no liquid; remove one of the two"
        yield whole(("start_from",), reason)
