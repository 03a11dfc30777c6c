"""Human demonstrations: an importer for public MiniWoB recordings and a recorder for a person at a Chrome window."""
