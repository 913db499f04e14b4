"""Error against time for every choice, and the cheapest choice for a tolerance."""
