"""Episode delivery on the learner's side: the ingest socket, admission control and the state that checkpoints keep."""
