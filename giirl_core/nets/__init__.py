"""Word vectors, page features, the policy and reward nets, and their parameters as bytes."""
