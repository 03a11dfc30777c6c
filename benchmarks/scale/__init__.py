"""How learning and cost scale with actors, browsers and nodes."""
