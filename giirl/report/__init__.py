"""HTML reports about runs: tables, charts, heat maps and episodes as film strips."""
