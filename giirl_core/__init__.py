"""The vocabulary that every package shares: types, configuration, metrics, sockets, processes, nets."""
