"""The policy net and the reward net, their input features, word vectors, and serialisation of parameters."""
