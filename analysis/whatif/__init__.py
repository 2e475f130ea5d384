"""What other thresholds would have made of the logged predictions."""
