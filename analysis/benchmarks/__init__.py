"""Benchmarks: the simulator, the log, the predictor and the view, next to their peers."""
