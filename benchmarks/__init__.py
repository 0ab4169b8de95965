"""Lets `python -m benchmarks.NAME` find what lies beside the script."""

import sys

sys.path.insert(0, __path__[0])
