"""Where two episodes diverge, why, and what it led to."""
