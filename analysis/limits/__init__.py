"""Limits: what no planner can be faster than, and what one that knows the floor plan needs."""
