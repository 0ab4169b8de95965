"""The calibration and prediction phases of the exoskeleton half."""
