"""The stiffness matrix of a whole mesh, nothing fixed."""

import numpy as np
from scipy.sparse import csr_matrix

from drake_exo.soles.elasticity import Pattern, assembled


def stiffness_matrix(mesh, material, element="linear") -> csr_matrix:
    """Of all nodes [N/m], (3n, 3n)."""
    pattern = Pattern.of(mesh, np.arange(len(mesh.nodes)), element)
    return assembled(mesh, material, pattern).tocsr()
