"""Compliant soles: simulate one through a step, or optimise its shape.

>>> import drake_exo as dx
>>> case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
>>> step = case.simulate()
>>> best = case.optimize()

Each name is imported when it is first used, so that importing `soles` costs
nothing.
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
