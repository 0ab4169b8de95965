"""Compliant soles: simulated through a step, and optimised in shape.

>>> import drake_exo as dx
>>> case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
>>> step = case.simulate()
>>> best = case.optimize()

Names are imported as they are asked for, so that importing this costs nothing.
"""

from importlib import import_module

_HOMES = {
    "EXAMPLE": "case",
    "Case": "case",
    "Design": "optimize.design",
    "Load": "loads",
    "Settings": "settings",
    "SphericalSpline": "shape",
    "Step": "step.results",
    "StoredDesign": "optimize.files",
    "TetMesh": "mesh",
    "compare_strains": "step.strain_comparison",
    "find_designs": "optimize.files",
    "pareto_front": "optimize.pareto",
}
__all__ = sorted(_HOMES)


def __getattr__(name: str):
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
