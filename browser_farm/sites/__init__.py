"""Tasks on pages of one's own: task files, and a farm that plays them in real time with a browser context each."""
