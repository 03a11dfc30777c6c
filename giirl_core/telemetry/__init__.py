"""How a process is observed from outside: its HTTP server, its health, and the addresses that Prometheus scrapes."""
