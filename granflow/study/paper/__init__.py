"""Zhou (2011) reproduced: its figures and tables from simulated collisions, and all laws side by side."""

from granflow.study.paper.report import write_paper

__all__ = ["write_paper"]
