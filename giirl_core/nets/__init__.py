"""Networks of policy and reward, the features they read, word vectors, and parameters as bytes."""
