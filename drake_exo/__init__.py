"""Contact calibration for exoskeletons and compliant soles for humanoids."""

__version__ = "0.1.0"
