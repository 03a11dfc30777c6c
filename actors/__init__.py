"""Actors: a policy plays episodes in many browser tabs at once, and a worker streams the episodes to the learner."""
