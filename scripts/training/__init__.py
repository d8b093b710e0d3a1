"""Training the learned landmark correction: quick pictures, samples, the network."""
