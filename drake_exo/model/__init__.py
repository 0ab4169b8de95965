"""The human and the exoskeleton: parameters, SDF, plant, planar dynamics."""
