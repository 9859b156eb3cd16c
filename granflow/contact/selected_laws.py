"""The contact laws of one scene, one per slot that the scene needs, and their layout in arrays."""

from collections.abc import Mapping
from dataclasses import dataclass

from granflow.contact.law import (
    CohesionLaw,
    HistoryField,
    Law,
    NormalLaw,
    RollingLaw,
    TangentialLaw,
    TwistingLaw,
)
from granflow.contact.material import PairMaterial


@dataclass(frozen=True)
class ContactLaws:
    """Laws of a scene; None for a slot that no pair of materials needs."""

    normal: NormalLaw
    tangential: TangentialLaw | None = None
    rolling: RollingLaw | None = None
    cohesion: CohesionLaw | None = None
    twisting: TwistingLaw | None = None

    @property
    def by_slot(self) -> Mapping[str, Law]:
        """The laws that are not None, by slot, in the order of the columns of the pair constants."""
        laws = {
            "normal": self.normal,
            "tangential": self.tangential,
            "rolling": self.rolling,
            "twisting": self.twisting,
            "cohesion": self.cohesion,
        }
        return {slot: law for slot, law in laws.items() if law is not None}

    @property
    def structure(self) -> tuple[tuple[str, Law], ...]:
        """Each slot with the structure of its law, see `Law.structure`."""
        return tuple((slot, law.structure) for slot, law in self.by_slot.items())

    @property
    def has_tangential(self) -> bool:
        """Whether a tangential model acts; kernels cannot compare with None."""
        return self.tangential is not None

    @property
    def damped_slots(self) -> tuple[str, ...]:
        """Slots, tangential or twisting, whose dashpot is a multiple of that of the normal model."""
        laws = {"tangential": self.tangential, "twisting": self.twisting}
        return tuple(slot for slot, law in laws.items() if law is not None and law.damped)

    @property
    def has_rolling(self) -> bool:
        """Whether a rolling model acts."""
        return self.rolling is not None

    @property
    def has_twisting(self) -> bool:
        """Whether a twisting model acts."""
        return self.twisting is not None

    @property
    def has_cohesion(self) -> bool:
        """Whether a cohesion model acts."""
        return self.cohesion is not None

    @property
    def acts_at_distance(self) -> bool:
        """Whether a model acts without overlap."""
        return self.cohesion is not None and self.cohesion.at_distance

    @property
    def transfers_liquid(self) -> bool:
        """Whether the cohesion model takes liquid from films on the particles."""
        return self.cohesion is not None and self.cohesion.transfers_liquid

    @property
    def range(self) -> float:
        """Largest distance [m] between two surfaces at which a model acts."""
        return self.cohesion.range if self.cohesion is not None else 0.0

    @property
    def attracts(self) -> bool:
        """Whether the normal force can be attractive."""
        return self.normal.attracts or self.has_cohesion

    @property
    def constant_names(self) -> Mapping[str, tuple[str, ...]]:
        """Names of the pair constants of each slot; a row of the pair constants has them in this order."""
        return {slot: law.constant_names for slot, law in self.by_slot.items()}

    @property
    def parameters(self) -> Mapping[str, Mapping[str, float]]:
        """Parameters of each slot by name; on the device, those of all slots are one row."""
        return {slot: law.parameters for slot, law in self.by_slot.items()}

    @property
    def history(self) -> Mapping[str, tuple[HistoryField, ...]]:
        """History fields of each slot, empty ones included."""
        return {slot: law.history for slot, law in self.by_slot.items()}

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Row of the pair constants. Raises ValueError for a pair that a model does not support."""
        return tuple(value for law in self.by_slot.values() for value in law.pair_constants(pair))
