"""Which contact parameters do the data determine?

After Van den Hof et al., as the paper uses it (II-C): singular values and
vectors of the sensitivity of the predicted contact forces to the parameters.
"""

from dataclasses import dataclass

import numpy as np

from drake_exo.optimal_control.kernels import (
    FORCE_UNIT,
    GROUND_MOMENT_UNIT,
    FootGroundKernel,
)
from drake_exo.phases.problem import PhaseResult

# Parameters whose sensitivities point this nearly the same way are coupled.
COUPLED = 0.99
_LEAST_FORCE = 20.0


@dataclass(frozen=True)
class Identifiability:
    """Sensitivity of forces to parameters, in units of noise and range.

    Attributes:
        names: parameters, length m.
        influence: (m,) RMS change of the forces, in standard deviations of
            their noise, when a parameter moves by a quarter of its range.
        singular_values: (m,) of the scaled sensitivity, largest first.
        directions: (m, m) rows are the parameter combinations.
        cosines: (m, m) between sensitivities; 1 for coupled parameters.
    """

    names: list[str]
    influence: np.ndarray
    singular_values: np.ndarray
    directions: np.ndarray
    cosines: np.ndarray

    def coupled_pairs(self) -> list[tuple[str, str, float]]:
        """Pairs that the data cannot tell apart, most coupled first."""
        pairs = [
            (self.names[i], self.names[j], float(self.cosines[i, j]))
            for i in range(len(self.names))
            for j in range(i + 1, len(self.names))
            if abs(self.cosines[i, j]) >= COUPLED
        ]
        return sorted(pairs, key=lambda pair: -abs(pair[2]))

    def advice(self) -> list[str]:
        """What to fix, one sentence for each coupled pair."""
        lines = []
        for first, second, cosine in self.coupled_pairs():
            i, j = self.names.index(first), self.names.index(second)
            weaker = first if self.influence[i] < self.influence[j] else second
            lines.append(
                f"{first} and {second} are coupled (cosine {cosine:+.4f}): "
                f"fix {weaker}, whose range moves the forces less"
            )
        return lines


def contact_sensitivity(result: PhaseResult) -> Identifiability:
    """Sensitivity of ground reaction and CoP at the calibrated motion.

    All parameters of the spheres are looked at, fixed ones included.
    """
    settings = result.settings
    kernel = FootGroundKernel(settings.law, settings.law_constants())
    scale = np.array([p.span / 4.0 for p in result.parameters])
    blocks = []
    for t in result.trajectories:
        n = len(t.times)
        values = np.broadcast_to(result.values(), (n, len(scale)))
        x = np.hstack([t.q[:, :3], t.v[:, :3], t.ground, values])
        J = kernel.jacobian(x, None)[:, :, 9:]
        J = J * np.array([FORCE_UNIT, FORCE_UNIT, GROUND_MOMENT_UNIT])[:, None]
        load = t.ground[:, 1]
        keep = load > _LEAST_FORCE
        J, load = J[keep], load[keep]
        cop = -t.ground[keep, 2] / load
        d_cop = -(J[:, 2] + cop[:, None] * J[:, 1]) / load[:, None]
        noise = settings.noise
        scaled = np.stack(
            [
                J[:, 0] / noise.force_n,
                J[:, 1] / noise.force_n,
                d_cop / noise.cop_m,
            ],
            axis=1,
        )
        blocks.append((scaled * scale).reshape(-1, len(scale)))
    return analyse([p.name for p in result.parameters], np.vstack(blocks))


def analyse(names: list[str], sensitivity: np.ndarray) -> Identifiability:
    """Analyse a scaled sensitivity matrix (outputs, parameters)."""
    norms = np.linalg.norm(sensitivity, axis=0)
    unit = sensitivity / np.maximum(norms, 1e-300)
    _, values, directions = np.linalg.svd(sensitivity, full_matrices=False)
    return Identifiability(
        names=list(names),
        influence=norms / np.sqrt(len(sensitivity)),
        singular_values=values,
        directions=directions,
        cosines=unit.T @ unit,
    )
