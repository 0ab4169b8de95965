"""Force and ZMP at even times, as a load of the soles."""

import numpy as np

from drake_exo.soles.loads import Load


def as_load(force, zmp, **more) -> Load:
    return Load(1.0 * np.arange(len(force)), force, zmp, **more)
