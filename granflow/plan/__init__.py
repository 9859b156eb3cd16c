"""The plan: all decisions for a scene before any array is allocated."""

from granflow.plan.explain import explain
from granflow.plan.plan import Plan, plan_for

__all__ = ["Plan", "explain", "plan_for"]
