"""The learner: Algorithm 1, its losses, its two nets, and where its trajectories come from."""
