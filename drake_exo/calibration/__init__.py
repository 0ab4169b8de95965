"""The phases: contact calibrated (A, B), movements predicted (C)."""
