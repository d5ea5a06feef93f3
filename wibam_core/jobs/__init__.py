"""Jobs and their stages as plain types: states, legal moves, leases. Knows no database, no queue and no web."""
