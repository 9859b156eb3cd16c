"""`granflow compare`: one scene under several normal laws, side by side."""

from granflow.study.compare.report import compare
from granflow.study.compare.variants import law_names

__all__ = ["compare", "law_names"]
