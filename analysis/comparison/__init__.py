"""Which group of episodes is better on the same floor plans, and how sure that is."""
