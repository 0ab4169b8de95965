"""Processing of a gait laboratory's recordings into trials."""
