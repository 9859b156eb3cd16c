"""Schema of the block `expect`: expectations for the results of a run."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from granflow.scene.schema import quantities as q
from granflow.scene.schema.faults import Fault, missing, whole
from granflow.scene.schema.fields import Flag, Model, Text, pair_list


class Expectation(Model):
    """An expectation for the results of a run: one comparison of one quantity, in SI units.

    The names are those of the totals in timeseries.csv, and NAME.PART for flow meters, walls, metrics and groups.

    >>> gf.Expectation(quantity="mass_flow.outlet", equals="0.5 kg/s", tolerance=0.05).equals
    0.5
    """

    quantity: Text = Field(description="quantity to compare, such as mass_flow.outlet")
    between: Annotated[tuple[q.AnyQuantity, q.AnyQuantity], pair_list("[smallest, largest]")] | None = Field(
        None, description="smallest and largest value"
    )
    below: q.AnyQuantity | None = Field(None, description="upper limit of the quantity")
    above: q.AnyQuantity | None = Field(None, description="lower limit of the quantity")
    equals: q.AnyQuantity | None = Field(None, description="expected value, within the tolerance")
    tolerance: q.NotNegative | None = Field(None, description="with equals: largest relative difference")
    any_scale: Flag = Field(False, description="true: evaluate at every scale of the scene; false: only at scale 1")

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless the expectation has exactly one comparison, with a tolerance for equals."""
        given = [key for key in ("between", "below", "above", "equals") if getattr(self, key) is not None]
        if len(given) != 1:
            found = f"has {' and '.join(given)}" if given else "has no comparison"
            yield whole((), f"{found}; give exactly one of between, below, above and equals")
            return
        if self.equals is not None and self.tolerance is None:
            yield missing(("tolerance",), "the largest relative difference from equals")
        if self.equals is None and self.tolerance is not None:
            yield Fault(("tolerance",), "it requires equals; remove tolerance")
        if self.between is not None and self.between[0] > self.between[1]:
            yield Fault(("between",), "the first value must be the smaller one")
