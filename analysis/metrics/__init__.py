"""Metrics of logs: of a step, of an episode, of many."""
