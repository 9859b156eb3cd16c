"""Normal models whose binary collision has a closed form."""

from typing import Protocol

from granflow.contact.material import PairMaterial


class BinaryCollision(Protocol):
    """Closed form of one binary collision at an approach velocity."""

    @property
    def restitution(self) -> float:
        """Restitution coefficient."""

    @property
    def unloading_stiffness(self) -> float:
        """Largest tangent stiffness [N/m], at the start of unloading."""

    def durations(self) -> tuple[float, float]:
        """Loading and unloading durations [s]."""


class ClosedFormCollision:
    """Base class of the models that return a `BinaryCollision`; precedes `NormalLaw` in their list of bases."""

    def collision(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> BinaryCollision:
        """Closed form of a collision of a pair."""
        raise NotImplementedError

    def phase_durations(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> tuple[float, float]:
        """Loading and unloading durations [s]."""
        return self.collision(pair, radius_eff, mass_eff, velocity).durations()

    def unloading_stiffness(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Tangent stiffness at the start of unloading [N/m]."""
        return self.collision(pair, radius_eff, mass_eff, velocity).unloading_stiffness

    def restitution(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Restitution coefficient, which follows from the constants of the model."""
        return self.collision(pair, radius_eff, mass_eff, velocity).restitution
