"""What it means: metrics of logs, and what a predictor or planner was worth."""
