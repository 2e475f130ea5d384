"""Estimates with intervals, and tests of significance, over floor plans."""
