"""`python -m drake_exo.cli` is `drake-exo`."""

import sys

from drake_exo.cli import main

sys.exit(main())
