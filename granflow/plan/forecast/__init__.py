"""Forecasts: what a plan can tell before the run about overlaps, walls, regions and servos that would go wrong."""
