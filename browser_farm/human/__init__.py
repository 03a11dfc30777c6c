"""Human demonstrations: recording a person in Chrome, and importing the public MiniWoB recordings."""
