"""Worker processes, their supervision, and Ray as the platform that runs them."""
