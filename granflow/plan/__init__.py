"""The plan: all decisions for a scene before any array is allocated.

`plan.plan_for(scene)` determines time step, skin, capacities and compile-time features on the host, in double
precision; `explain.explain(plan)` returns them as text with the reason for each.
"""
