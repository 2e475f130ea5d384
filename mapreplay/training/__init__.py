"""Training the map predictor: simulated observations, batches, the loop."""
