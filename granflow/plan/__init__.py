"""The plan: all decisions for a scene before any array is allocated.

`plan_for(scene)` determines time step, skin, capacities and compile-time features on the host, in double precision;
`explain(plan)` returns them as text with the reason for each.
"""

from granflow.plan.explain import explain
from granflow.plan.plan import Plan, plan_for

__all__ = ["Plan", "explain", "plan_for"]
