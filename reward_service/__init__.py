"""The learned reward as a service: trajectories in, rewards and their version out."""
