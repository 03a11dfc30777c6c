"""Worker processes: their base class, supervision with restarts, and the platform that runs them on Ray."""
