"""`granflow compare`: one scene with several normal contact models, side by side."""

from granflow.studies.compare.report import compare
from granflow.studies.compare.variants import law_names

__all__ = ["compare", "law_names"]
