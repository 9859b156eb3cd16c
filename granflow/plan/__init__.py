"""What is decided about a scene before anything is allocated."""

from granflow.plan.plan import Plan, plan_for

__all__ = ["Plan", "plan_for"]
