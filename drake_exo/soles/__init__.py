"""Compliant soles: simulated through a step, and optimised in shape.

>>> import drake_exo as dx
>>> case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
>>> step = case.simulate()
>>> best = case.optimize()

Names are imported as they are asked for, so that importing this costs nothing.
"""

import drake_exo

__getattr__, __dir__, __all__ = drake_exo.on_demand(
    __name__,
    {
        "case": ["EXAMPLE", "Case"],
        "loads": ["Load"],
        "mesh": ["SphericalSpline", "TetMesh"],
        "optimize.design": ["Design"],
        "optimize.files": ["StoredDesign", "find_designs"],
        "optimize.search": ["pareto_front"],
        "settings": ["Settings"],
        "results": ["Step", "sole_samples"],
        "finite_strain": ["compare_strains"],
    },
)
