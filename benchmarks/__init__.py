"""Lets `python -m benchmarks.NAME` import modules beside the script."""

import sys

sys.path.insert(0, __path__[0])
