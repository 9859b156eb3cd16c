"""What leaving out saves: a scene timed step for step as it stands, and with one feature after the other off or on."""

from granflow.study.feature_cost.measure import FeatureCost, feature_costs
from granflow.study.feature_cost.report import HEADS, cost_rows, remarks, write_feature_costs
from granflow.study.feature_cost.variants import FeatureVariant, variants_of

__all__ = [
    "HEADS",
    "FeatureCost",
    "FeatureVariant",
    "remarks",
    "cost_rows",
    "feature_costs",
    "variants_of",
    "write_feature_costs",
]
