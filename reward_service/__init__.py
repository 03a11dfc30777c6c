"""The reward service: scores trajectories with the learned reward and returns the rewards with their version."""
