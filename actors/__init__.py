"""Actors: policy inference over many tabs at once, and the worker that streams what they do."""
