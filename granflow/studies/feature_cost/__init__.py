"""Cost of features: step time of a scene, and of its variants with one feature switched on or off."""

from granflow.studies.feature_cost.measure import FeatureCost, feature_costs
from granflow.studies.feature_cost.report import HEADS, cost_rows, remarks, write_feature_costs
from granflow.studies.feature_cost.variants import FeatureVariant, variants_of

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
