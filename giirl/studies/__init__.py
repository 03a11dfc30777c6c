"""Studies: many training runs with different settings and seeds, summarised in a table or figure."""
