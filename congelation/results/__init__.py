"""Records of runs: the record itself, the store, and what a user opens."""
