"""Chrome: starting and ending it, its DevTools connection, tabs, trusted input and crash recovery."""
