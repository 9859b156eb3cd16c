"""What leaving out saves: a scene timed step for step as it stands, and with one feature after the other off or on."""

from granflow.study.leaving_out.measure import Saving, savings
from granflow.study.leaving_out.report import HEADS, remarks, saving_rows, write_savings
from granflow.study.leaving_out.variants import Variant, variants_of

__all__ = ["HEADS", "Saving", "Variant", "remarks", "saving_rows", "savings", "variants_of", "write_savings"]
