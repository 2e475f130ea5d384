"""What is kept: a step to and from MCAP, and a log to Rerun."""
