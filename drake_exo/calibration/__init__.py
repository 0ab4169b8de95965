"""Contact calibration (Phases A, B), prediction (C) and design (D)."""
