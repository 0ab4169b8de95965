"""Force laws and their derivatives, and LeafSystems around them.

Names are imported on first use.
"""

import drake_exo

__getattr__, __dir__, __all__ = drake_exo.on_demand(
    __name__,
    {
        "bushing": ["BushingParameters", "bushing_deflection", "bushing_force"],
        "diagram": ["connect_forces"],
        "hunt_crossley": ["paper_stiffness", "sphere_force"],
        "parameters": ["ContactSphere", "GroundContact"],
        "reduction": ["SoleLaw", "reduce_sole"],
        "strap": ["GainController", "Gains"],
        "systems": [
            "AssistController",
            "FootGroundContact",
            "HumanExoskeletonBushings",
            "TrackingController",
        ],
    },
)
