"""Many logs: an episode in a row, and which episodes belong together."""
