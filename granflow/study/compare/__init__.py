"""`granflow compare`: one scene with several normal contact models, side by side."""

from granflow.study.compare.report import compare
from granflow.study.compare.variants import law_names

__all__ = ["compare", "law_names"]
